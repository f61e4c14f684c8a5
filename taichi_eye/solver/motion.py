"""Carries the fluid nodes along with the cornea (see `taichi_eye.solver.aqueous`, node motion)."""

from taichi_eye.lang import ti
from taichi_eye.solver.aqueous import Aqueous
from taichi_eye.solver.cornea import Cornea


@ti.data_oriented
class Motion:
    """Moves the nodes of the aqueous humour under the current cornea."""

    def __init__(self, cornea: Cornea, aqueous: Aqueous):
        self.cornea, self.aqueous = cornea, aqueous

    @ti.kernel
    def move_nodes(self):
        """Place every node of every eye according to the cornea's displacement above it."""
        for i in range(self.aqueous.neighbours.total[None]):
            self.aqueous.move_node(i, self.cornea.rest, self.cornea.place)

    @ti.kernel
    def move_nodes_under(self, wall_place: ti.template()):
        """The same for a cornea at `wall_place`, a field like its own places."""
        for i in range(self.aqueous.neighbours.total[None]):
            self.aqueous.move_node(i, self.cornea.rest, wall_place)

    @ti.func
    def move_eye(self, eye, team: ti.template(), lane):
        """The same for a lane's share of the nodes of one eye."""
        first = self.aqueous.first[eye]
        start, end = team.share(first, first + self.aqueous.count[eye], lane)
        for i in range(start, end):
            self.aqueous.move_node(i, self.cornea.rest, self.cornea.place)
