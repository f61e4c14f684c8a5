"""Teams of CPU threads: the compiled kernels that a block of a GPU's threads runs, run where no GPU is.

A lane sits on a thread of its own and spins at every meeting until the others of its eye have come, so that what one
lane reads before another has written it can show, as can what the compiler moves over a meeting. A lane that does not
come leaves the others waiting: they give up after so many turns, and go on without.

    PYTHONPATH=. python tests/solver/team_bench.py sums             seconds: what `test_team.py` runs
    PYTHONPATH=. python tests/solver/team_bench.py eyes             a minute or two of compiling; prints differences

Both take a process of their own and two lanes, since lanes without a processor each wait for their turns at length.
"""

import json
import math
import sys

import numpy as np
from plain import ALL_OF_A_WALL

from taichi_eye import backend
from taichi_eye.lang import ti
from taichi_eye.scene import load_scene
from taichi_eye.solver import coupling
from taichi_eye.solver.batch import Batch
from taichi_eye.solver.team import ONE_THREAD, Team

PATIENCE = 1_000_000_000  # turns of all waiting of a run


@ti.data_oriented
class SpinningTeam(Team):
    """A CPU thread to each lane of an eye."""

    def __init__(self, lanes: int, eyes: int):
        super().__init__(lanes, eyes, width=ONE_THREAD)
        self.block = None
        self.arrived, self.waited = (ti.field(ti.i32, eyes) for _ in range(2))

    def stuck(self) -> bool:
        """Whether somebody has waited in vain."""
        return bool(self.waited.to_numpy().max() >= PATIENCE)

    @ti.func
    def meet(self, eye):
        # as many must have come as make this round full; who has waited too long in all waits no more
        arrived = ti.atomic_add(self.arrived[eye], 1)
        waited = ti.atomic_max(self.waited[eye], 0)
        while ti.atomic_max(self.arrived[eye], 0) < (arrived // self.lanes + 1) * self.lanes and waited < PATIENCE:
            waited += 1
        ti.atomic_max(self.waited[eye], waited)

    @ti.func
    def stretch(self, eyes, others):
        """Indices of a lane, which a CPU thread takes in a row: a seat at each eye's team, then its share of others."""
        return ti.max(ONE_THREAD, eyes + (others + self.lanes - 1) // self.lanes)

    @ti.func
    def extent(self, eyes, others):
        return self.lanes * self.stretch(eyes, others)

    @ti.func
    def seat(self, n, eyes, others):
        lane, eye = n // self.stretch(eyes, others), n % self.stretch(eyes, others)
        other = (eye - eyes) * self.lanes + lane
        if eye >= eyes:
            eye = -1
            if other >= others:
                # nobody's
                eye, lane, other = 0, -1, 0
        return eye, lane, other


LANES = 2
SHORT = ("numerics.spacing_mm=0.4", "numerics.sound_speed_m_s=20", "puff.duration_ms=2", "numerics.duration_ms=1")
# all that a wall may have; an open chamber without slip; loose coupling
EYES = (
    (),
    (*ALL_OF_A_WALL, "numerics.spacing_mm=0.35"),
    ("chamber.sealed=false", "puff.peak_kpa=3", "numerics.wall_condition=no_slip"),
    ("numerics.coupling=loose", "eye.iop_mmhg=25"),
)


def outcomes_of(together: bool, broken: int | None = None):
    """What becomes of every eye; whether a team got stuck.

    together: all eyes in launches for each pass, and not each by its team from end to end; broken: an eye that gets a
    node without a velocity half-way.
    """
    coupling.SERIAL_NODES = 0 if together else 4000
    backend.threads = lambda: 9 if together else 1
    batch = Batch([load_scene(None, (*SHORT, *keys)) for keys in EYES])

    def spoil(batch):
        if broken is not None and batch.sample == 5:
            batch.cornea.velocity[int(batch.first[broken]) + 3] = [0.0, np.nan]

    return batch.run(spoil), batch.coupling.team


def apart(outcomes, others, leave_out=None) -> float:
    """The largest difference between traces, over each one's largest value; the balance of energies is nothing but
    differences."""
    return max(
        np.abs(values - other.traces[name]).max() / max(np.abs(values).max(), 1e-300)
        for eye, (outcome, other) in enumerate(zip(outcomes, others))
        for name, values in outcome.traces.items()
        if name not in ("energy_error_uj", "coupling_residual") and eye != leave_out
    )


def compare_eyes() -> None:
    """Print how far eyes stepped by teams are from eyes stepped by one thread."""
    backend.init("cpu", "f64", 1)
    alone, _ = outcomes_of(together=False)
    backend.init("cpu", "f64", LANES)
    coupling.team_for, coupling.PARTS = (lambda eyes: SpinningTeam(LANES, eyes)), 5
    for together in (False, True):
        (first, _), (again, team) = outcomes_of(together), outcomes_of(together)
        way = "launches for each pass" if together else "each from end to end"
        print(f"{way}: {apart(alone, first):.1e} from one thread, {apart(first, again):.1e} from run to run", end="")
        print(", stuck" if team.stuck() else "")
    broken, team = outcomes_of(together=False, broken=1)
    print(f"beside a broken eye ({broken[1].stop.what}): {apart(alone, broken, leave_out=1):.1e}", end="")
    print(", stuck" if team.stuck() else "")


@ti.data_oriented
class Heap:
    """Numbers that a team sums, and looks through for the largest and the smallest."""

    def __init__(self, team, capacity: int):
        self.team, self.number, self.found = team, ti.field(ti.f64, capacity), ti.field(ti.f64, 6)

    @ti.kernel
    def look(self, count: int):
        for n in range(self.team.extent(1, 0)):
            _, lane, _ = self.team.seat(n, 1, 0)
            if lane >= 0:
                start, end = self.team.share(0, count, lane)
                total, top, bottom, at_top, at_bottom = 0.0, -ti.math.inf, ti.math.inf, 0, 0
                for i in range(start, end):
                    x = self.number[i]
                    total += x
                    if x > top:
                        top, at_top = x, i
                    if x < bottom:
                        bottom, at_bottom = x, i
                sums, tops, places = self.team.combine(
                    0, lane, ti.Vector([total, 1.0]), ti.Vector([top, -bottom]), ti.Vector([at_top, at_bottom])
                )
                if lane == 0:
                    for c in ti.static(range(2)):
                        self.found[c], self.found[2 + c], self.found[4 + c] = sums[c], tops[c], places[c]


def check_sums(seed: int) -> None:
    """Print, as JSON, for heaps of any size what a team found in them beside what is there; a team's sum over the sum
    of the numbers' sizes."""
    backend.init("cpu", "f64", LANES)
    rng, told = np.random.default_rng(seed), []
    team = SpinningTeam(LANES, 1)
    heap = Heap(team, 500)
    for count in (1, 2, 3, *rng.integers(4, 500, 6).tolist()):
        numbers = rng.standard_normal(500) * 10.0 ** rng.integers(-6, 6, 500)
        numbers[rng.integers(0, count, 2)] = numbers[rng.integers(0, count)]
        heap.number.from_numpy(numbers)
        heap.look(count)
        total, lanes, top, bottom, at_top, at_bottom = heap.found.to_numpy().tolist()
        numbers = numbers[:count]
        told.append(
            {
                "error": abs(total - math.fsum(numbers)) / np.abs(numbers).sum(),
                "found": [lanes, top, -bottom, at_top, at_bottom],
                "there": [LANES, numbers.max(), numbers.min(), int(numbers.argmax()), int(numbers.argmin())],
            }
        )
    print(json.dumps({"told": told, "stuck": team.stuck()}))


if __name__ == "__main__":
    if sys.argv[1] == "sums":
        check_sums(int(sys.argv[2]))
    else:
        compare_eyes()
