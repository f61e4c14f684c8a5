"""`taichi-eye films`: the renderer held against the instrument's frames, and the analysis against the eyes it reads.

A part is a module of this room with `measure(stage)`, as in `taichi_eye.bench`: rows of figures beside what is asked.
`optics`, `reading`, `damaged` and `speed` take four minutes together; the random studies `back_edges`, `obstacles` and
`mutations` read hundreds of films each and take longer. Their `measure` takes the number of films and a seed, too.
"""

from taichi_eye.bench import bench
from taichi_eye.proof.films import back_edges, damaged, mutations, obstacles, optics, reading, speed

PARTS = {
    "optics": optics.measure,
    "reading": reading.measure,
    "damaged": damaged.measure,
    "back_edges": back_edges.measure,
    "obstacles": obstacles.measure,
    "mutations": mutations.measure,
    "speed": speed.measure,
}


def report(only=(), out: str | None = None, json_file: str | None = None) -> bool:
    """Measure the parts named (all without names), print the table, write page and JSON; whether all that is asked
    holds."""
    return bench.report(only, out, json_file, parts=PARTS, command="films")
