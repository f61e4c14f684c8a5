"""Images cut into strips, one strip to a turn of a parallel loop.

Taichi hands a CPU thread at least 512 turns of a loop at once, more than an image has rows or columns. A strip therefore has
as many turns and is drawn in the first of them, by plain loops that keep what a column or a row has in common in registers.
On a GPU a strip is one row or column, and every turn draws.
"""
import taichi as ti

from taichi_eye.backend import on_cpu

GRAIN = 512       # a power of two
STRIPS = 8


class Strips:
    """`length` rows or columns in strips. turns: of the parallel loop over them."""

    def __init__(self, length: int):
        self.length = length
        self.count, self.grain = (min(STRIPS, length), GRAIN) if on_cpu() else (length, 1)
        self.turns = self.count * self.grain

    @ti.func
    def bounds(self, turn):
        """First row or column that this turn draws, and the one after its last; none in most turns."""
        first = 0
        after = 0
        if turn & (self.grain - 1) == 0:
            strip = turn // self.grain
            first = strip * self.length // self.count
            after = (strip + 1) * self.length // self.count
        return first, after
