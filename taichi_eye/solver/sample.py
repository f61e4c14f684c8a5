"""One sample of many eyes: their time steps, the motion of their nodes, and the survey of what came out.

Small eyes on a CPU do all three in one launch, each from end to end on one thread: its fields stay in that thread's
cache, and an eye does the same arithmetic in the same order whatever stands beside it. A single eye does it in two
launches: the two kernels compile in half the time of one. Elsewhere (a GPU, one large eye on many threads) each part of
a step is a loop over the nodes of all eyes; an eye that needs fewer steps than another waits.
"""
import numpy as np
import taichi as ti

from taichi_eye import backend
from taichi_eye.solver.coupling import SERIAL_NODES, Coupling
from taichi_eye.solver.motion import Motion
from taichi_eye.solver.survey import QUANTITIES, Survey

BLOCK = 512  # least iterations of a parallel loop that Taichi hands to a CPU thread at once


@ti.data_oriented
class Sampler:
    """Takes eyes from one sample to the next."""

    def __init__(self, coupling: Coupling, motion: Motion, survey: Survey):
        self.coupling, self.motion, self.survey = coupling, motion, survey

    def take(self, eyes, steps, dt, dt_before, puff_apex, rows) -> dict[str, np.ndarray]:
        """steps[k] steps of dt[k] [s] of each eye eyes[k]; its figures go into rows[eyes[k]] [eyes, quantities].

        puff_apex [k, step] [Pa]: the puff on the axis at the end of each step; dt_before [k]: the step before this call,
        as in `Coupling.advance`. Returns the columns of rows by name.
        """
        nodes, kick_dt = self.coupling.aqueous.nodes[eyes], 0.5 * (dt + dt_before)
        if backend.on_cpu() and (len(eyes) >= backend.threads() or nodes.max() <= SERIAL_NODES):
            pace = np.column_stack([eyes, steps, dt, kick_dt])
            if len(eyes) == 1:
                # at rest there is nothing to step: the film's first frame need not wait for that kernel to compile
                if steps.any():
                    self._march_one(pace, puff_apex)
                self._survey_one(int(eyes[0]), rows)
            else:
                # the most costly first, so that no thread is left with one at the end
                order = np.argsort(-steps * nodes, kind="stable")
                self._take_each(pace[order], puff_apex[order], rows)
        else:
            self.coupling.advance_in_parallel(eyes, steps, dt, kick_dt, puff_apex)
            self.motion.move_nodes()
            self.survey.measure(eyes.astype(np.int32), rows)
        return dict(zip(QUANTITIES, rows.T))

    @ti.func
    def _carry_through(self, k, pace: ti.template(), puff: ti.template(), rows: ti.template()):
        eye = int(pace[k, 0])
        self.coupling.march(eye, k, pace, puff)
        self.motion.move_eye(eye)
        self.survey.measure_eye(eye, rows)

    @ti.kernel
    def _march_one(self, pace: ti.types.ndarray(), puff: ti.types.ndarray()):
        ti.loop_config(serialize=True)
        for k in range(pace.shape[0]):
            self.coupling.march(int(pace[k, 0]), k, pace, puff)

    @ti.kernel
    def _survey_one(self, eye: int, rows: ti.types.ndarray()):
        ti.loop_config(serialize=True)
        for once in range(1):
            self.motion.move_eye(eye)
            self.survey.measure_eye(eye, rows)

    @ti.kernel
    def _take_each(self, pace: ti.types.ndarray(), puff: ti.types.ndarray(), rows: ti.types.ndarray()):
        # a block to an eye: 32 iterations, however heavy, would all go to one thread
        for n in range(pace.shape[0] * BLOCK):
            if n % BLOCK == 0:
                self._carry_through(n // BLOCK, pace, puff, rows)
