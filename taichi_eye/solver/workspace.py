"""The fields and kernels of a coupled pair, reused from one simulation to the next.

Fields are allocated for a capacity, a power of two, and hold any smaller cloud; kernels belong to the fields they were
compiled for. A workspace that its simulation no longer holds goes to the next one that fits, which then compiles
nothing.
"""

import weakref

import numpy as np

from taichi_eye import backend
from taichi_eye.solver.aqueous import Aqueous
from taichi_eye.solver.cornea import Cornea
from taichi_eye.solver.coupling import Coupling
from taichi_eye.solver.motion import Motion
from taichi_eye.solver.sample import Sampler
from taichi_eye.solver.state import Snapshot, State
from taichi_eye.solver.survey import Survey

SMALLEST = 2048  # nodes: scenes below share one set of kernels, in this process and in the offline cache
# nodes on top: a node's values in fields a power of two apart all fall into the same few lines of a cache (a tenth of a
# step
# at 16000 nodes)
SPREAD = 56
FEWEST = 32  # eyes, likewise: one eye and a batch share their kernels, too

_free: dict[tuple, list] = {}


class Workspace:
    """Corneas, aqueous humours and what steps and measures them, for up to `nodes` nodes of up to `eyes` eyes.

    Both are indexed alike, so the cornea's fields are as long as the liquid's, though it fills the start of each eye
    only.
    """

    def __init__(self, nodes: int, eyes: int, basis: str):
        self.cornea = Cornea(nodes, eyes=eyes)
        self.aqueous = Aqueous(nodes, basis, eyes=eyes)
        self.coupling = Coupling(self.cornea, self.aqueous)
        self.motion = Motion(self.cornea, self.aqueous)
        self.survey = Survey(self.cornea, self.aqueous, self.coupling)
        self.sampler = Sampler(self.coupling, self.motion, self.survey)
        self.snapshot = Snapshot(
            {**self.cornea.evolving(), **self.aqueous.evolving(), "built_place": self.survey.built_place},
            {**self.cornea.evolving_of_eyes(), **self.aqueous.evolving_of_eyes()},
        )

    def restore(self, state: State) -> None:
        """Take up the fields of a state (`Batch.state`), the eyes being set up at rest."""
        self.snapshot.put(state)
        rebuilt = np.zeros(len(self.aqueous.nodes), dtype=np.int32)
        rebuilt[: len(state["rebuilds"])] = state["rebuilds"] > 0
        if rebuilt.any():
            self.motion.move_nodes_under(self.survey.built_place)
            self.aqueous.rebuild(rebuilt)
            # a rebuild lays out anew what the state holds as it was
            self.snapshot.put(state)
        self.motion.move_nodes()


def capacity(count: int, smallest: int = SMALLEST) -> int:
    """The power of two, at least `smallest`, that holds `count`."""
    held = smallest
    while held < count:
        held *= 2
    return held


def reuse(holder, kind: tuple, make):
    """Something of a kind, made by `make()` where none is free; free again once `holder` is gone."""
    free = _free.setdefault(kind, [])
    workspace = free.pop() if free else make()
    weakref.finalize(holder, free.append, workspace).atexit = False
    return workspace


def borrow(holder, nodes: int, eyes: int, basis: str) -> Workspace:
    """A workspace for `nodes` nodes of `eyes` eyes; free again once `holder` is gone."""
    sizes = capacity(nodes) + SPREAD, capacity(eyes, FEWEST)
    return reuse(holder, (backend.generation(), *sizes, basis), lambda: Workspace(*sizes, basis))
