"""Teams of CPU threads: what a block of a GPU's threads runs, run where no GPU is, and told on stdout as JSON.

A lane sits on a thread of its own and spins at every meeting until the others of its eye have come. So whatever one
lane reads before another has written it shows as a difference, and a lane that does not come to a meeting as a team
that is stuck: the lanes give up after so many turns, and go on without waiting. How many lanes work is asked when
the program runs, so that one compilation serves any number up to the most.

Run as a program in a process of its own: it takes as many threads as lanes, and might hang where a test fails.
"""

import json
import sys

import numpy as np

from taichi_eye import backend
from taichi_eye.lang import ti
from taichi_eye.scene import load_scene
from taichi_eye.solver import coupling
from taichi_eye.solver.batch import Batch
from taichi_eye.solver.team import ONE_THREAD, Team

PATIENCE = 1_000_000_000  # turns of all waiting of a run


@ti.data_oriented
class SpinningTeam(Team):
    """Up to `lanes` threads to an eye; `working` says how many."""

    def __init__(self, lanes: int, eyes: int):
        super().__init__(lanes, eyes, width=ONE_THREAD)
        self.block = None
        self.working = ti.field(ti.i32, ())
        self.arrived, self.waited = (ti.field(ti.i32, eyes) for _ in range(2))

    def engage(self, lanes: int) -> None:
        """From now on so many lanes work."""
        self.working[None] = lanes
        self.arrived.fill(0)
        self.waited.fill(0)

    def stuck(self) -> bool:
        """Whether somebody has waited in vain since."""
        return bool(self.waited.to_numpy().max() >= PATIENCE)

    @ti.func
    def size(self):
        # while an eye is set up nobody has said yet
        return ti.max(self.working[None], 1)

    @ti.func
    def meet(self, eye):
        # as many must have come as make this round full; who has waited too long in all waits no more
        arrived = ti.atomic_add(self.arrived[eye], 1)
        waited = ti.atomic_max(self.waited[eye], 0)
        while ti.atomic_max(self.arrived[eye], 0) < (arrived // self.size() + 1) * self.size() and waited < PATIENCE:
            waited += 1
        ti.atomic_max(self.waited[eye], waited)

    @ti.func
    def stretch(self, eyes, others):
        """Indices of a lane, which a CPU thread takes in a row: a seat at each eye's team, then its share of others."""
        return ti.max(ONE_THREAD, eyes + (others + self.size() - 1) // self.size())

    @ti.func
    def extent(self, eyes, others):
        return self.size() * self.stretch(eyes, others)

    @ti.func
    def seat(self, n, eyes, others):
        lane, eye = n // self.stretch(eyes, others), n % self.stretch(eyes, others)
        other = (eye - eyes) * self.size() + lane
        if eye >= eyes:
            eye = -1
            if other >= others:
                # nobody's
                eye, lane, other = 0, -1, 0
        return eye, lane, other


MOST = 4
SHORT = ("numerics.spacing_mm=0.4", "numerics.sound_speed_m_s=20", "puff.duration_ms=2", "numerics.duration_ms=0.5")
# all that a wall may have: a shell that shears and relaxes under a jet that feels the dent, a globe behind; an open
# chamber; loose coupling
EYES = (
    (),
    (
        "cornea.flexural_modulus_mpa=0.1",
        "cornea.viscoelastic_share=0.3",
        "cornea.shear_modulus_kpa=10",
        "cornea.shear_viscosity_ms=0.1",
        "chamber.compliance_mm3_mmhg=0.2",
        "chamber.globe_law=friedenwald",
        "puff.dent_feedback=0.5",
        "numerics.spacing_mm=0.35",
    ),
    ("chamber.sealed=false", "puff.peak_kpa=3", "numerics.wall_condition=no_slip"),
    ("numerics.coupling=loose", "eye.iop_mmhg=25"),
)


def scenes():
    return [load_scene(None, (*SHORT, *keys)) for keys in EYES]


def histories(lanes: int, together: bool, broken: int | None = None):
    """What every eye's traces are with so many lanes, and whether a team got stuck.

    together: all eyes in launches for each pass, and not each by its team from end to end; broken: an eye that gets a
    node without a velocity half-way.
    """
    coupling.SERIAL_NODES = 0 if together else 4000
    batch = Batch(scenes())
    team = batch.coupling.team
    team.engage(lanes)

    def spoil(batch):
        if broken is not None and batch.sample == 5:
            batch.cornea.velocity[int(batch.first[broken]) + 3] = [0.0, np.nan]

    outcomes = batch.run(spoil)
    return {
        "traces": [{name: column.tolist() for name, column in outcome.traces.items()} for outcome in outcomes],
        "stops": [outcome.stop.what if outcome.stop else "" for outcome in outcomes],
        "steps": batch.steps.tolist(),
        "stuck": team.stuck(),
    }


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
                    0,
                    lane,
                    ti.Vector([total, 1.0, 0.0]),
                    ti.Vector([top, -bottom]),
                    ti.Vector([at_top, at_bottom]),
                )
                total, lanes, top, bottom, at_top, at_bottom = sums[0], sums[1], tops[0], -tops[1], places[0], places[1]
                if lane == 0:
                    for c, x in ti.static(enumerate((total, lanes, top, at_top, bottom, at_bottom))):
                        self.found[c] = x


def sums(seed: int):
    """For heaps of any size: the numbers, and what teams of every size found in them."""
    rng, found = np.random.default_rng(seed), []
    team = SpinningTeam(MOST, 1)
    heap = Heap(team, 500)
    for count in (1, 2, 3, 4, 5, *rng.integers(6, 500, 6).tolist()):
        numbers = rng.standard_normal(500) * 10.0 ** rng.integers(-6, 6, 500)
        numbers[rng.integers(0, count, 2)] = numbers[rng.integers(0, count)]
        heap.number.from_numpy(numbers)
        for lanes in range(1, MOST + 1):
            team.engage(lanes)
            heap.look(count)
            found.append([numbers[:count].tolist(), lanes, heap.found.to_numpy().tolist()])
    return {"found": found, "stuck": team.stuck()}


def main():
    backend.init("cpu", "f64", MOST)
    coupling.team_for = lambda eyes: SpinningTeam(MOST, eyes)
    coupling.PARTS = 5
    said = {"sums": sums(int(sys.argv[1]))}
    for together in (False, True):
        said[f"together {together}"] = [[lanes, histories(lanes, together)] for lanes in (2, 3, 4, 2)]
    said["broken"] = histories(3, together=False, broken=1)
    print(json.dumps(said))


if __name__ == "__main__":
    main()
