"""`taichi-eye films`: the renderer held against the instrument's frames, and the analysis against the eyes it reads.

A part is a module of this room with `measure(stage)`, as in `taichi_eye.bench`: rows of figures beside what is asked.
Without names the parts STANDARD are measured, four minutes together. The random studies run only when they are named:
`back_edges` (300 films, 10 minutes), `obstacles` (100 films, 7 minutes), `mutations` (2000 inputs, 14 minutes). Their
`measure` takes the number of films and a seed, too.
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
STANDARD = "optics", "reading", "damaged", "speed"


def report(only=(), out: str | None = None, json_file: str | None = None, progress: bool = True) -> bool:
    """Measure the parts named (STANDARD without names), print the table, write page and JSON; whether all that is
    asked holds."""
    return bench.report(only or STANDARD, out, json_file, parts=PARTS, command="films", progress=progress)
