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
    def move_eye(self, eye):
        """The same for the nodes of one eye."""
        for i in range(self.aqueous.first[eye], self.aqueous.first[eye] + self.aqueous.count[eye]):
            self.aqueous.move_node(i, self.cornea.rest, self.cornea.place)
