"""Tables of random text: read with the numbers that stand in them, or refused as bad input is."""

import tempfile
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from taichi_eye.errors import SceneError
from taichi_eye.scene.table import read_puff_file, read_table

TABLES = settings(max_examples=100, deadline=None)
WANTED = ("time_ms", "apex_displacement_mm", "deflection_mm")
CELLS = st.floats(-1e3, 1e3).map(repr) | st.sampled_from(
    ["", "x", "nan", "inf", "1e999", "1,5", '"', "#", "-", "1_000"]
)
# those too small to be normal are zero once the kernel language runs
NUMBERS = st.floats(-100, 100, allow_subnormal=False)
ROWS = st.lists(st.lists(CELLS, min_size=1, max_size=4).map(",".join), max_size=8)


def read(data, reader, *arguments):
    """What the reader makes of a file with these bytes; None where it refuses them."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "table.csv"
        path.write_bytes(data)
        try:
            return reader(path, *arguments)
        except SceneError as refusal:
            assert str(path) in str(refusal)
            return None


def sound(table):
    """What holds for every table that was read."""
    lengths = {len(column) for column in table.values()}
    assert len(lengths) == 1 and lengths.pop() >= 2 and all(np.isfinite(column).all() for column in table.values())
    assert (np.diff(table["time_ms"]) > 0).all()


@TABLES
@given(st.binary(max_size=300))
def test_any_bytes_are_a_table_or_a_refusal(data):
    assert read(data, read_puff_file) is None
    table = read(b"time_ms,deflection_mm\n" + data, read_table, WANTED)
    if table is not None:
        sound(table)


@TABLES
@given(st.text(max_size=300))
def test_any_text_is_a_table_or_a_refusal(text):
    table = read(("time_ms,deflection_mm\n" + text).encode("utf-8", "surrogatepass"), read_table, WANTED)
    if table is not None:
        sound(table)


@TABLES
@given(ROWS)
def test_rows_of_odd_cells_are_a_table_or_a_refusal(rows):
    table = read("\n".join(["time_ms,deflection_mm", *rows]).encode(), read_table, WANTED)
    if table is not None:
        sound(table)


@TABLES
@given(
    st.lists(NUMBERS, min_size=2, max_size=30, unique=True).map(sorted),
    st.data(),
    st.sampled_from(["\n", "\r\n"]),
    st.booleans(),
)
def test_a_sound_table_is_read_to_the_last_bit_whatever_its_lines_and_columns(times, data, newline, marked):
    values = data.draw(st.lists(NUMBERS, min_size=len(times), max_size=len(times)))
    columns = {"time_ms": times, "pressure_kpa": values, "remark": ["a"] * len(times)}
    order = data.draw(st.permutations(sorted(columns)))
    lines = [",".join(order)] + [",".join(str(columns[name][row]) for name in order) for row in range(len(times))]
    text = newline.join(lines) + newline * data.draw(st.integers(0, 2))
    found = read((("\ufeff" if marked else "") + text).encode(), read_puff_file)
    assert found is not None
    np.testing.assert_array_equal(found[0], times)
    np.testing.assert_array_equal(found[1], values)
