"""Images cut into strips, one strip to a turn of a parallel loop.

Taichi hands a CPU thread at least 512 turns of a loop at once, more than an image has rows or columns. A strip
therefore has as many turns and is drawn in the first of them, by plain loops that keep what a column or a row has in
common in registers. On a GPU a strip is one row or column, and every turn draws.
"""

from taichi_eye.backend import on_cpu
from taichi_eye.lang import ti

GRAIN = 512  # a power of two
STRIPS = 8


class Strips:
    """Strips of up to `capacity` rows or columns. turns: of the parallel loop over them.

    A kernel asks `draws` first: a turn that only found its bounds equal would cost 3 ns.
    """

    def __init__(self, capacity: int):
        self.count, self.grain = (STRIPS, GRAIN) if on_cpu() else (capacity, 1)
        self.turns = self.count * self.grain

    @ti.func
    def draws(self, turn):
        """Whether this turn has a strip to draw."""
        return turn & (self.grain - 1) == 0

    @ti.func
    def first(self, turn, length):
        """First of so many rows or columns in its strip."""
        return turn // self.grain * length // self.count

    @ti.func
    def after(self, turn, length):
        """The one after its last."""
        return (turn // self.grain + 1) * length // self.count
