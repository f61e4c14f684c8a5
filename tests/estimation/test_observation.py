"""What is taken from a path, what is refused, and how what was measured is predicted."""

import numpy as np
import pytest
from closed_form import BASE, TIMES_MS, apex_mm

from taichi_eye.errors import NoEstimate, SceneError
from taichi_eye.estimation import model_error
from taichi_eye.estimation.model_error import ModelError
from taichi_eye.estimation.motion import cheap
from taichi_eye.estimation.observation import STATIONS_MM, ParameterRow, ReadDeflection, of_film, of_history
from taichi_eye.estimation.reading import read
from taichi_eye.report.traces import write_traces
from taichi_eye.scene import load_scene

DEPTH = apex_mm(BASE)


def written(path, time=TIMES_MS, depth=DEPTH, head="time_ms,deflection_mm"):
    path.write_text(head + "\n" + "".join(f"{t:.9g},{d:.9g}\n" for t, d in zip(time, depth)))
    return path


def test_a_trace_in_other_units_is_the_same_trace(tmp_path):
    plain = read(written(tmp_path / "a.csv"), BASE).seen[0]
    other = read(written(tmp_path / "b.csv", 1e-3 * TIMES_MS, 1e3 * DEPTH, "Time [s],deflection (um)"), BASE)
    assert other.seen[0].values == pytest.approx(plain.values) and other.seen[0].time_ms == pytest.approx(plain.time_ms)
    assert any("converted" in note for note in other.notes)
    assert (
        not plain.retreats
        and read(written(tmp_path / "c.csv", head="time_ms,apex_displacement_mm"), BASE).seen[0].retreats
    )


@pytest.mark.parametrize(
    "time, depth, words",
    [
        (TIMES_MS, 0.02 * DEPTH, "moves by .* um: no air puff"),
        (TIMES_MS, 4.0 * DEPTH, "no eye gives way by more than 2 mm"),
        (TIMES_MS[:40], DEPTH[:40], "values from 6 to 24 ms"),
        (TIMES_MS[40:], DEPTH[40:], "does not begin with the eye at rest"),
        (TIMES_MS, DEPTH + 0.2, "does not begin with the eye at rest"),
        (1e3 * TIMES_MS, DEPTH, "is it in us"),
        (TIMES_MS, 1e3 * DEPTH, "is it in um"),
        (TIMES_MS, -DEPTH, "inward displacements must be positive"),
    ],
)
def test_traces_of_no_puff_are_refused(tmp_path, time, depth, words):
    with pytest.raises(SceneError, match=words):
        read(written(tmp_path / "a.csv", time, depth), BASE)


def test_a_gap_is_told_and_a_cell_left_blank_is_none(tmp_path):
    keep = (TIMES_MS < 9.0) | (TIMES_MS > 13.0)
    path = written(tmp_path / "a.csv", TIMES_MS[keep], DEPTH[keep])
    path.write_text(path.read_text() + "40,\n")
    found = read(path, BASE)
    assert len(found.seen[0].values) == keep.sum() and any("no values from" in note for note in found.notes)
    assert any("blank" in note for note in found.notes)


def test_a_run_s_own_traces_hold_no_retreat_and_are_thinned_to_a_camera_s_pace(tmp_path):
    eye = load_scene(None, ["eye.whole_eye_movement_mm=0.3", "numerics.spacing_mm=0.25"])
    from taichi_eye.ladder.rungs import with_numerics
    from taichi_eye.ladder.trial import run_scene

    traces = run_scene(with_numerics(eye, fidelity="cavity")).traces
    write_traces(tmp_path / "traces.csv", traces)
    seen = read(tmp_path / "traces.csv", eye).seen[0]
    assert not seen.retreats and len(seen.values) <= 301 and seen.noise_mm == pytest.approx(0.001)
    motion = cheap(with_numerics(eye, fidelity="cavity"))
    assert seen.predict(motion) == pytest.approx(seen.values, abs=0.004)
    whole = of_history("whole", seen.time_ms, seen.values, True)
    assert whole.predict(motion) - seen.predict(motion) == pytest.approx(motion.retreat_mm(seen.time_ms))
    read_as_films = of_history("film", seen.time_ms, seen.values, False, read=True)
    assert isinstance(read_as_films, ReadDeflection)
    shown = motion.histories
    inside = read_as_films.time_ms < 30.0
    expected = np.interp(read_as_films.time_ms, shown.time_ms, shown.apex_mm - shown.whole_eye_mm)
    assert read_as_films.predict(motion)[inside] == pytest.approx(expected[inside], abs=0.003)
    surface = of_film("film", shown, {})
    assert surface.predict(motion) == pytest.approx(surface.values, abs=5e-4) and set(surface.x_mm) == set(STATIONS_MM)
    # a motion that was stopped shows nothing beyond
    short = cheap(eye.but({"numerics.fidelity": "cavity", "numerics.duration_ms": 20.0, "camera.frame_count": "auto"}))
    assert np.isnan(seen.predict(short)[seen.time_ms > 20.1]).all()
    assert np.isfinite(seen.predict(short)[seen.time_ms < 19.9]).all()


def test_covariances_are_covariances_and_a_model_error_is_where_the_dent_is():
    history = of_history("a", TIMES_MS, DEPTH, False, 0.01)
    error = ModelError(0.025, {}, 0.1)
    covariance = history.model_error(error, history.values)
    assert np.linalg.eigvalsh(covariance)[0] > -1e-12
    top = int(np.argmax(DEPTH))
    # what passes and what lasts, each as large; the apex stands still there, so that being late does not show
    assert np.sqrt(covariance[top, top]) == pytest.approx(np.sqrt(2.0) * 0.025, rel=0.01) and covariance[0, 0] < 1e-6
    expected = (1.0 + model_error.correlation(0.2315, 2.0)) / 2.0
    assert covariance[top, top + 1] / covariance[top, top] == pytest.approx(expected, rel=0.01)
    late = int(np.argmin(np.gradient(DEPTH)))
    assert covariance[late, late] > 0.025**2 * (1.0 + DEPTH[late] / DEPTH[top])
    row = ParameterRow(
        "r",
        np.array([1.0, 7.5]),
        np.array(["x", "y"]),
        names=("da_ratio_1mm", "a1_time_ms"),
        deviations=np.array([0.1, 0.2]),
    )
    assert np.sqrt(np.diag(row.model_error(ModelError(0.0, {"a1_time_ms": 0.3}, 0.1), row.values))) == pytest.approx(
        [0.1, 0.3]
    )
    assert not row.model_error(model_error.NONE, row.values).any()


def test_the_model_error_of_a_scene_is_its_distance_from_living_eyes():
    near = model_error.of_scene(BASE)
    assert model_error.LEAST_MM <= near.history_mm <= model_error.MOST_MM
    # the default eye dents deeper than a living one by what its error says
    assert near.parameters["deformation_amplitude_mm"] >= model_error.LEAST_SHARE * 0.108
    weak = model_error.of_scene(BASE.but({"puff.peak_kpa": 5.0}))
    assert weak.parameters["deformation_amplitude_mm"] > near.parameters["deformation_amplitude_mm"]
    assert near.of("a1_time_ms", 7.0) == near.parameters["a1_time_ms"] and near.of("unjudged", -2.0) == 2.0 * near.share


def test_nothing_there_is_said(tmp_path):
    with pytest.raises(SceneError, match="no such file"):
        read(tmp_path / "no.mp4", BASE)
    with pytest.raises(SceneError, match="no such file"):
        read(tmp_path / "no.csv", BASE)
    assert issubclass(NoEstimate, SceneError)
