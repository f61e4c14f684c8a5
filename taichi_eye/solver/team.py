"""The threads that carry out one eye's work together.

A team has `lanes` threads. What one of them does alone (the wall, and in a batch the nodes, too) is shared out: a lane
takes its own stretch of nodes, and where it reads what another lane has written, all meet first. On a GPU a team is a
block of threads, since only a block can meet inside a launch: the language runs indices n to n + lanes - 1 of a loop
with `block_dim` lanes in one block, and goes on from them to later ones by whole blocks. On a CPU a team is one thread,
at compile time: nothing meets, a stretch is the whole, and the code is what it would be without teams.

Rules for what a team runs. Every lane comes to every meeting, so a branch or a loop around one depends only on what is
the same for all of them: the eye's settings, or what `combine` gave. A value that one lane writes for the eye, lane 0
by custom, is read by others after a meeting only. A node belongs to one lane throughout a pass.

Sums over a team are added in a fixed order: each lane's own share, then groups of lanes, then the groups. So a run is
the same to the last bit whenever it is made again on the same device, and to rounding across devices.
"""

import math

from taichi_eye import backend
from taichi_eye.backend import real
from taichi_eye.lang import ti

# threads of a block: the coupled step's passes take some 200 registers a thread, of which an H100's multiprocessor has
# 65 536, and the language asks for two blocks to each
LANES = 128
ONE_THREAD = 512  # iterations of a parallel loop, at the least, that the language hands to a CPU thread at once


@ti.data_oriented
class Team:
    """Teams of `lanes` threads, one to each of `eyes` eyes; one lane needs no eyes.

    A loop over the eyes of a launch is one over `extent(eyes)` indices, whose `seat` says eye and lane. width: the
    indices that an eye takes up in it, of which the first `lanes` do something.
    """

    def __init__(self, lanes: int = 1, eyes: int = 0, width: int = ONE_THREAD):
        self.lanes, self.width = lanes, width
        self.block = lanes if lanes > 1 else None  # of threads, where a loop has to name one
        if lanes > 1:
            self.group = math.isqrt(lanes - 1) + 1  # lanes whose shares are added first
            self.groups = -(-lanes // self.group)
            shares = lambda size, count: ti.Vector.field(size, real(), (eyes, count))
            self.sums, self.group_sums = shares(4, lanes), shares(4, self.groups)
            self.tops, self.group_tops = shares(2, lanes), shares(2, self.groups)

    @ti.func
    def meet(self, eye):
        """Every lane waits here for the others of its eye, and then sees what they have written."""
        if ti.static(self.lanes > 1):
            ti.simt.block.sync()

    @ti.func
    def extent(self, eyes, others):
        """The indices of a loop over the teams of so many eyes and then so many others, each for itself."""
        return eyes * self.width + others

    @ti.func
    def seat(self, n, eyes, others):
        """What index n of such a loop is: eye and lane (-1 of an idle one), or an eye of -1 and which of the others."""
        eye, lane, other = n // self.width, n % self.width, 0
        if eye >= eyes:
            eye, lane, other = -1, -1, n - eyes * self.width
        elif ti.static(self.width != self.lanes):
            if lane >= self.lanes:
                lane = -1
        return eye, lane, other

    @ti.func
    def share(self, first, end, lane):
        """A lane's stretch, start and end, of the indices from `first` to `end`."""
        start, stop = first, end
        if ti.static(self.lanes > 1):
            start = first + (end - first) * lane // self.lanes
            stop = first + (end - first) * (lane + 1) // self.lanes
        return start, stop

    @ti.func
    def combine(self, eye, lane, sums, tops):
        """The sums, and the largest, over the lanes of an eye of what each brings: four and two numbers.

        All meet twice. A maximum forgets NaN, a sum does not.
        """
        total, top = sums, tops
        if ti.static(self.lanes > 1):
            self.sums[eye, lane], self.tops[eye, lane] = sums, tops
            self.meet(eye)
            # by the time that shares are written again, all have met once more: who reads them has done so
            if lane < self.groups:
                first = lane * self.group
                total, top = self.sums[eye, first], self.tops[eye, first]
                for k in range(first + 1, ti.min(first + self.group, self.lanes)):
                    total += self.sums[eye, k]
                    top = ti.max(top, self.tops[eye, k])
                self.group_sums[eye, lane], self.group_tops[eye, lane] = total, top
            self.meet(eye)
            total, top = self.group_sums[eye, 0], self.group_tops[eye, 0]
            for k in range(1, self.groups):
                total += self.group_sums[eye, k]
                top = ti.max(top, self.group_tops[eye, k])
        return total, top

    @ti.func
    def sum(self, eye, lane, a, b, c, d):
        """The sums over the lanes of an eye of four numbers that each brings."""
        total, unused = self.combine(eye, lane, ti.Vector([a, b, c, d]), ti.Vector([0.0, 0.0]))
        return total[0], total[1], total[2], total[3]

    @ti.func
    def most(self, eye, lane, a, at_a, b, at_b):
        """The largest over the lanes of an eye of two values that each brings, each with the first place where it is.

        NaN counts as infinite.
        """
        most_a, most_b, where_a, where_b = a, b, at_a, at_b
        if ti.static(self.lanes > 1):
            none = ti.Vector([0.0, 0.0, 0.0, 0.0])
            own = ti.Vector([a, b])
            for c in ti.static(range(2)):
                if ti.math.isnan(own[c]):
                    own[c] = ti.math.inf
            unused, top = self.combine(eye, lane, none, own)
            place = ti.Vector([-ti.math.inf, -ti.math.inf])
            if own[0] == top[0]:
                place[0] = -at_a
            if own[1] == top[1]:
                place[1] = -at_b
            unused, place = self.combine(eye, lane, none, place)
            most_a, most_b, where_a, where_b = top[0], top[1], int(-place[0]), int(-place[1])
        return most_a, where_a, most_b, where_b

    @ti.func
    def least(self, eye, lane, a, at_a, b, at_b):
        """The same of the smallest."""
        most_a, where_a, most_b, where_b = self.most(eye, lane, -a, at_a, -b, at_b)
        return -most_a, where_a, -most_b, where_b


ALONE = Team()
"""One thread, wherever it runs."""


def team_for(eyes: int) -> Team:
    """The team that steps an eye on the backend in force: a block of threads under CUDA, else one."""
    if backend.settings()["arch"] == "cuda":
        return Team(LANES, eyes, width=LANES)
    return ALONE
