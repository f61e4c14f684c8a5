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
COLUMNS = 24  # numbers that a team may put together at once
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
            groups = -(-lanes // self.group)
            self.shares, self.group_shares, self.whole = (
                ti.field(real(), (eyes, COLUMNS, *shape)) for shape in ((lanes,), (groups,), ())
            )
            self.places, self.group_places, self.whole_place = (
                ti.field(ti.i32, field.shape) for field in (self.shares, self.group_shares, self.whole)
            )

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
    def sum(self, eye, lane, numbers):
        """The sums over the lanes of an eye of a vector of numbers that each brings. All meet."""
        total = numbers
        if ti.static(self.lanes > 1):
            for c in ti.static(range(numbers.n)):
                self.shares[eye, c, lane] = numbers[c]
            self._put_together(eye, lane, numbers.n, numbers.n)
            for c in ti.static(range(numbers.n)):
                total[c] = self.whole[eye, c]
        return total

    @ti.func
    def combine(self, eye, lane, numbers, tops, places):
        """Sums as above; of a second vector the largest, and the first lane's place that has it. All meet.

        A maximum forgets NaN, a sum does not.
        """
        total, top, place = numbers, tops, places
        if ti.static(self.lanes > 1):
            for c in ti.static(range(numbers.n)):
                self.shares[eye, c, lane] = numbers[c]
            for c in ti.static(range(tops.n)):
                self.shares[eye, numbers.n + c, lane] = tops[c]
                self.places[eye, numbers.n + c, lane] = places[c]
            self._put_together(eye, lane, numbers.n, numbers.n + tops.n)
            for c in ti.static(range(numbers.n)):
                total[c] = self.whole[eye, c]
            for c in ti.static(range(tops.n)):
                top[c] = self.whole[eye, numbers.n + c]
                place[c] = self.whole_place[eye, numbers.n + c]
        return total, top, place

    @ti.func
    def _put_together(self, eye, lane, summed: ti.template(), columns: ti.template()):
        """So many columns of the lanes' shares into one number each: the first ones summed, of the others the largest.

        First groups of lanes, then the groups, each column of each by one lane. What is read here is written again
        after another meeting only. Few accesses in the code: the language takes time for each beside every other one.
        """
        self.meet(eye)
        groups = (self.lanes - 1) // self.group + 1
        for m in range((columns * groups - lane + self.lanes - 1) // self.lanes):
            c, g = (m * self.lanes + lane) % columns, (m * self.lanes + lane) // columns
            first = g * self.group
            value, place = self.shares[eye, c, first], self.places[eye, c, first]
            for k in range(first + 1, ti.min(first + self.group, self.lanes)):
                share = self.shares[eye, c, k]
                if c < summed:
                    value += share
                elif share > value:
                    value, place = share, self.places[eye, c, k]
            self.group_shares[eye, c, g], self.group_places[eye, c, g] = value, place
        self.meet(eye)
        for m in range((columns - lane + self.lanes - 1) // self.lanes):
            c = m * self.lanes + lane
            value, place = self.group_shares[eye, c, 0], self.group_places[eye, c, 0]
            for g in range(1, groups):
                share = self.group_shares[eye, c, g]
                if c < summed:
                    value += share
                elif share > value:
                    value, place = share, self.group_places[eye, c, g]
            self.whole[eye, c], self.whole_place[eye, c] = value, place
        self.meet(eye)


ALONE = Team()
"""One thread, wherever it runs."""


def team_for(eyes: int) -> Team:
    """The team that steps an eye on the backend in force: a block of threads under CUDA, else one."""
    if backend.settings()["arch"] == "cuda":
        return Team(LANES, eyes, width=LANES)
    return ALONE
