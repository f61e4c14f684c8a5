"""A team of threads does with an eye what one thread does with it, however its lanes get ahead of one another."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from plain import ALL_OF_A_WALL, PartedWays, Plain, Vector, as_python, in_turns
from processes import python

from taichi_eye.scene import load_scene
from taichi_eye.solver.batch import Batch
from taichi_eye.solver.coupling import plan_of
from taichi_eye.solver.figures import NOT_CONVERGED, QUANTITIES, at
from taichi_eye.solver.team import LANES, ONE_THREAD, Team

COARSE = ("numerics.spacing_mm=0.5", "numerics.sound_speed_m_s=20")
# all that a wall may have; an open chamber without slip; loose coupling
EYES = (
    (*ALL_OF_A_WALL, "numerics.spacing_mm=0.5"),
    ("chamber.sealed=false", "numerics.wall_condition=no_slip"),
    ("numerics.coupling=loose", "eye.iop_mmhg=25"),
)
DT, STEPS = 2e-6, 2


class Eyes:
    """Three unlike eyes that a sudden puff has set in motion, and what is to be done next, by eye."""

    def __init__(self):
        self.batch = Batch([load_scene(None, (*COARSE, *keys)) for keys in EYES])
        self.plan = plan_of(
            np.arange(3), np.full(3, STEPS), np.full(3, DT), np.full(3, DT), np.full((3, STEPS), 4000.0)
        )
        self.coupling = self.batch.coupling
        for _ in range(8):
            self.coupling.march_all(self.plan)
        # sweeps are counted since they were last read
        self.batch.survey.measure(np.arange(3, dtype=np.int32), np.zeros((3, len(QUANTITIES))))

    def stretch(self, eye):
        """The nodes of an eye."""
        return slice(int(self.batch.first[eye]), int(self.batch.first[eye]) + self.batch.clouds[eye].count)

    def figures(self, coupling, eye):
        """All that a step leaves of an eye, by name, of a coupling or of a plain one."""
        cornea, aqueous = coupling.cornea, coupling.aqueous
        fields = {**self.batch.cornea.evolving(), **self.batch.aqueous.evolving()}
        of_eyes = {**self.batch.cornea.evolving_of_eyes(), **self.batch.aqueous.evolving_of_eyes()}
        found = {}
        for name in fields:
            owner, own = (cornea, name[7:]) if name.startswith("cornea_") else (aqueous, name[8:])
            values = getattr(owner, own).to_numpy()[self.stretch(eye)]
            found[name] = values.reshape(len(values), -1)
        for name in of_eyes:
            owner = (
                aqueous.globe if name.startswith("globe_") else aqueous if hasattr(self.batch.aqueous, name) else cornea
            )
            found[name] = getattr(owner, name.removeprefix("globe_")).to_numpy()[eye]
        for name in ("sweeps", "worst_residual", "status"):
            found[name] = getattr(coupling, name).to_numpy()[eye]
        return found


class Bare:
    """Nothing but a team."""

    team = None


@pytest.fixture(scope="module")
def eyes():
    return Eyes()


@pytest.fixture(scope="module")
def after(eyes):
    """What one thread makes of each eye, from the state in which `eyes` leaves it; the state is put back."""
    workspace = eyes.batch._workspace
    count = eyes.stretch(2).stop
    before = workspace.snapshot.take(count, 3)
    eyes.coupling.march_all(eyes.plan)
    found = [eyes.figures(eyes.coupling, eye) for eye in range(3)]
    rows = np.zeros((3, len(QUANTITIES)))
    eyes.batch.survey.measure(np.arange(3, dtype=np.int32), rows)
    workspace.snapshot.put(before)
    return found, rows


def by_team(eyes, eye, lanes, seed):
    rng = np.random.default_rng(seed)
    work = lambda lane, coupling: coupling.march(eye, lane, eye, eyes.plan)
    return in_turns(lanes, rng, eyes.coupling, work)


def assert_close(found, expected, tolerance=1e-12):
    for name, values in expected.items():
        # two of the figures are nothing but what rounding leaves
        if name not in ("cornea_lost", "worst_residual"):
            # what is added to the pressure is a difference of such
            scale = np.abs(expected["aqueous_pressure"] if name == "pressure_shift" else values).max()
            np.testing.assert_allclose(found[name], values, rtol=0, atol=tolerance * scale, err_msg=name)


def assert_same(found, expected):
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values, err_msg=name)


@pytest.mark.parametrize("eye", range(3))
def test_lanes_in_any_order_do_what_one_thread_does(eyes, after, eye):
    found = eyes.figures(by_team(eyes, eye, 3, 1), eye)
    assert_close(found, after[0][eye])
    assert found["sweeps"] == after[0][eye]["sweeps"]
    # to the same bits, whoever comes first
    assert_same(eyes.figures(by_team(eyes, eye, 3, 2), eye), found)


def test_more_lanes_than_nodes_of_the_wall_do_so_too(eyes, after):
    assert_close(eyes.figures(by_team(eyes, 0, 40, 3), 0), after[0][0])


def test_one_lane_has_the_bits_of_one_thread(eyes, after):
    # of what the two write alike: exp and its like differ in the last bit between C's library and LLVM's
    assert_close(eyes.figures(by_team(eyes, 1, 1, 0), 1), after[0][1], 1e-14)


@pytest.mark.parametrize("eye", (0, 1))
def test_loops_over_all_nodes_with_a_team_for_the_wall_do_the_same(eyes, after, eye):
    """The way of one large eye: the mean pressure's sum in parts, the wall's passes by a team, the nodes each alone."""
    parts, lanes, nodes, rng = 5, 3, eyes.stretch(eye), np.random.default_rng(eye)

    def step(lane, plain, load):
        team, liquid = plain.team, plain.aqueous
        if lane == 0:
            for part in range(parts):
                plain.pressure_part[eye, part] = liquid.pressure_sums(eye, part, parts)
        plain.move_wall(eye, lane, load, DT)
        if lane == 1:
            for i in rng.permutation(np.arange(nodes.start, nodes.stop)).tolist():
                liquid.kick(eye, i, DT, plain.cornea.velocity)
        team.meet(eye)
        first, end = team.share(0, parts, lane)
        shares = [plain.pressure_part[eye, part] for part in range(first, end)]
        plain.match_wall(eye, lane, DT, sum(share[0] for share in shares), sum(share[1] for share in shares))
        team.meet(eye)
        if lane == 0:
            for i in rng.permutation(np.arange(nodes.start, nodes.stop)).tolist():
                liquid.compress(eye, i, DT, plain.wall_velocity)
        team.meet(eye)

    def steps(lane, plain):
        if lane == 0:
            plain.pressure_part = {}
        for k in range(STEPS):
            step(lane, plain, float(eyes.plan[eye, 4 + k]))

    assert_close(eyes.figures(in_turns(lanes, rng, eyes.coupling, steps), eye), after[0][eye])


def test_a_broken_wall_neither_hangs_its_team_nor_touches_another_eye(eyes):
    def march(lane, plain):
        if lane == 0:
            plain.cornea.velocity[int(eyes.batch.first[0]) + 2] = [0.0, math.nan]
        plain.team.meet(0)
        plain.march(0, lane, 0, eyes.plan)

    plain = in_turns(4, np.random.default_rng(5), eyes.coupling, march)
    broken = eyes.figures(plain, 0)
    assert broken["status"] == NOT_CONVERGED and np.isnan(broken["cornea_velocity"]).any()
    for eye in (1, 2):
        assert_same(eyes.figures(plain, eye), eyes.figures(eyes.coupling, eye))


@pytest.mark.parametrize("eye", range(3))
@pytest.mark.parametrize("lanes", (3, 30))
def test_a_team_measures_what_one_thread_does(eyes, eye, lanes):
    expected, found = np.zeros((2, 3, len(QUANTITIES)))
    eyes.batch.survey.measure(np.arange(3, dtype=np.int32), expected)
    measure = lambda lane, plain: plain.measure_eye(eye, found, plain.team, lane)
    in_turns(lanes, np.random.default_rng(lanes), eyes.batch.survey, measure)
    sweeps = [at.coupling_sweeps, at.coupling_residual]  # since they were last read
    found[:, sweeps] = expected[:, sweeps] = 0.0
    scale = 1e-12 * np.abs(expected[eye]) + 1e-12 * np.abs(expected[eye, at.aqueous_elastic])
    scale[at.volume_error] = 1e-14  # of one, which is taken off
    np.testing.assert_array_less(np.abs(found - expected)[eye], scale + 1e-18)


@pytest.mark.parametrize("count", (1, 2, 7, 38, 211))
def test_sums_and_extremes_over_any_number_of_lanes(count):
    rng = np.random.default_rng(count)
    numbers = rng.standard_normal(count) * 10.0 ** rng.integers(-6, 6, count)
    numbers[rng.integers(0, count, 2)] = numbers.max()
    told = {}

    def look(lane, plain):
        first, end = plain.share(0, count, lane)
        own = numbers[first:end].tolist()
        total = plain.sum(0, lane, Vector([sum(own), 1.0]))
        top = max(own, default=-math.inf)
        sums, tops, places = plain.combine(
            0, lane, Vector([sum(own)]), Vector([top, -math.inf]), Vector([first + own.index(top) if own else 0, 3])
        )
        told[lane] = [*total, *sums, *tops, *places]

    for lanes in (5, 128):
        in_turns(lanes, rng, Bare(), lambda lane, plain: look(lane, plain.team))
        assert len(told) == lanes and all(said == told[0] for said in told.values())
        total, who, again, top, nothing, where, _ = told[0]
        assert total == again == pytest.approx(math.fsum(numbers), abs=1e-14 * np.abs(numbers).sum())
        assert (who, top, nothing) == (lanes, numbers.max(), -math.inf) and where == np.argmax(numbers)
        told.clear()


@pytest.mark.parametrize("parts", (1, 2, 7, 500))
def test_parts_of_the_mean_pressure_take_every_node_once(eyes, parts):
    for eye in range(3):
        nodes, told = eyes.stretch(eye), []
        in_turns(
            1,
            np.random.default_rng(0),
            eyes.coupling,
            lambda lane, plain: told.append([plain.aqueous.pressure_sums(eye, part, parts) for part in range(parts)]),
        )
        volume, pressure = (getattr(eyes.batch.aqueous, name).to_numpy()[nodes] for name in ("volume", "pressure"))
        work, weight = zip(*told[0])
        assert math.fsum(weight) == pytest.approx(math.fsum(volume), rel=1e-14)
        assert math.fsum(work) == pytest.approx(
            math.fsum(volume * pressure), abs=1e-14 * np.abs(volume * pressure).sum()
        )


def test_a_plan_in_the_devices_memory_is_the_plan(eyes):
    rng = np.random.default_rng(9)
    for steps in (3, 1, 11, 4):
        plan = rng.random((5, steps))
        sent = eyes.coupling._sent(plan).to_numpy()
        np.testing.assert_array_equal(sent[:, :steps], plan)
        assert not sent[:, steps:].any()


def test_a_block_of_a_gpu_is_one_team_and_a_cpu_thread_another():
    for crew in (Team(LANES, 4, width=LANES), Team()):
        plain = Plain(crew, {}, lambda call: call())
        with as_python():
            eyes, others = 4, 1000
            seats = [plain.seat(n, eyes, others) for n in range(plain.extent(eyes, others))]
        busy = [(eye, lane) for eye, lane, _ in seats if eye >= 0 and lane >= 0]
        assert busy == [(eye, lane) for eye in range(eyes) for lane in range(crew.lanes)]
        assert [other for eye, _, other in seats if eye < 0] == list(range(others))
        # where the language cuts the loop, into blocks or into stretches of a CPU thread, no team is cut
        cut = crew.block or ONE_THREAD
        for start in range(0, len(seats), cut):
            assert len({eye for eye, lane, _ in seats[start : start + cut]}) == 1


def test_a_lane_that_misses_a_meeting_is_found():
    def work(lane, plain):
        if lane != 1:
            plain.team.meet(0)

    with pytest.raises(PartedWays):
        in_turns(3, np.random.default_rng(0), Bare(), work)


def test_reading_before_a_meeting_is_found():
    """What the others here stand on: a race comes out one way or the other."""
    told = set()
    for seed in range(20):
        slots = [0] * 3

        def work(lane, plain):
            slots[lane] = 1
            if lane == 0:
                told.add(sum(slots))

        in_turns(3, np.random.default_rng(seed), Bare(), work)
    assert told == {1, 2, 3}


def test_threads_that_meet_sum_as_they_should():
    said = python(Path(__file__).with_name("team_bench.py"), "sums", 7)
    assert said.returncode == 0, said.stderr
    found = json.loads(said.stdout.splitlines()[-1])
    assert not found["stuck"] and len(found["told"]) == 9
    for heap in found["told"]:
        assert heap["error"] < 1e-14 and heap["found"] == heap["there"]
