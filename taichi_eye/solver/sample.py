"""One sample of many eyes: their time steps, the motion of their nodes, and the survey of what came out.

Small eyes, and many, do all three in one launch, each from end to end by its team (`taichi_eye.solver.team`), a thread
of a CPU or a block of a GPU: its fields stay in that thread's cache, and an eye does the same arithmetic in the same
order whatever stands beside it. A single eye does it in two launches: the two kernels compile in half the time of one.
Elsewhere (one large eye on many threads, a few on a GPU) each part of a step is a loop over the nodes of all eyes; an
eye that needs fewer steps than another waits.
"""

import numpy as np

from taichi_eye import backend
from taichi_eye.lang import ti
from taichi_eye.solver.coupling import Coupling, plan_of
from taichi_eye.solver.figures import QUANTITIES
from taichi_eye.solver.motion import Motion
from taichi_eye.solver.survey import Survey


def _launches(coupling: Coupling, motion: Motion, survey: Survey):
    """The kernels of a sample: the survey of an eye, and steps and survey of many eyes in parallel.

    Closures, since a launch of a method costs half as much again in Python.
    """

    team = coupling.team

    @ti.func
    def settle(eye, lane, rows: ti.template()):
        motion.move_eye(eye, team, lane)
        # who measures a node asks for its neighbours
        team.meet(eye)
        survey.measure_eye(eye, rows, team, lane)

    @ti.kernel
    def look(eye: int, rows: ti.types.ndarray()):
        if ti.static(team.block):
            ti.loop_config(block_dim=team.block)
        elif ti.static(team.lanes == 1):
            ti.loop_config(serialize=True)
        for n in range(team.extent(1, 0)):
            _, lane, _ = team.seat(n, 1, 0)
            if lane >= 0:
                settle(eye, lane, rows)

    @ti.kernel
    def take_each(plan: ti.types.ndarray(), rows: ti.types.ndarray()):
        if ti.static(team.block):
            ti.loop_config(block_dim=team.block)
        for n in range(team.extent(plan.shape[0], 0)):
            k, lane, _ = team.seat(n, plan.shape[0], 0)
            if lane >= 0:
                coupling.march(int(plan[k, 0]), lane, k, plan)
                settle(int(plan[k, 0]), lane, rows)

    return look, take_each


class Sampler:
    """Takes eyes from one sample to the next, and keeps the figures of their last ones.

    rows [eyes, quantities]: the survey's figures; figures: its columns by name. No Taichi class: each look-up in one
    costs some 3 us.
    """

    def __init__(self, coupling: Coupling, motion: Motion, survey: Survey):
        self._march = backend.launcher(coupling.march_all)
        self._look, self._take_each = (backend.launcher(kernel) for kernel in _launches(coupling, motion, survey))
        self.coupling, self.motion, self.survey, self._nodes = coupling, motion, survey, coupling.aqueous.nodes
        self.rows = np.zeros((len(self._nodes), len(QUANTITIES)))

    def figures(self, eyes: int) -> dict[str, np.ndarray]:
        """The figures of the first so many eyes at their last sample, by name; they change with the next one."""
        return dict(zip(QUANTITIES, self.rows[:eyes].T))

    def take(self, eyes, steps, dt, dt_before, puff_apex) -> None:
        """steps[k] steps of dt[k] [s] of each eye eyes[k], and its figures.

        puff_apex [k, step] [Pa]: the puff on the axis at the end of each step; dt_before [k]: the step before this
        call, as in `Coupling.advance`.
        """
        nodes, kick_dt = self._nodes[eyes], 0.5 * (dt + dt_before)
        plan = plan_of(eyes, steps, dt, kick_dt, puff_apex)
        if self.coupling.marches(nodes):
            if len(eyes) == 1:
                # at rest there is nothing to step: the film's first frame need not wait for that kernel to compile
                if steps[0]:
                    self._march(plan)
                self._look(int(eyes[0]), self.rows)
            else:
                # the most costly first, so that no thread or block is left with one at the end
                self._take_each(plan[np.argsort(-steps * nodes, kind="stable")], self.rows)
        else:
            self.coupling.advance_in_parallel(plan)
            self.motion.move_nodes()
            self.survey.measure(eyes.astype(np.int32), self.rows)
