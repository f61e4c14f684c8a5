"""The rungs of the ladder, cheapest first: what each is for, what it leaves out, and where its simulation is.

    membrane    cornea under a constant IOP. No liquid: no volume to hold, no inertia. What studies without a fluid did;
                the right model of an open chamber at slow loads, 3 times too deep in a sealed one.
    cavity      cornea over a uniform pressure that holds the chamber's volume (its stiffness is the bulk modulus of
                water and the globe's compliance). Leaves out inertia and flow: the default eye's peak is 0.5 % shallow,
                its
                flanks 0.04 ms early, 2 % of the peak at the worst instant.
    added_mass  cornea over incompressible potential flow. Leaves out viscosity, vorticity and sound.
    mfpm        the weakly compressible, viscous liquid on moving nodes.

All share scene, cornea, puff, globe, film, figures, guards and traces. To add a rung: its simulation, and a line here.
Its simulation has the public names of `taichi_eye.solver.reduced.Reduced`.
"""

from dataclasses import dataclass
from importlib import import_module


@dataclass(frozen=True)
class Rung:
    """A model of the liquid.

    where: "module:class" of its simulation, imported once it is asked for; packs_nodes: whether it computes on a node
    cloud; holds_volume: whether a sealed chamber is felt; refresh_travel: travel of the cornea in spacings after which
    weights or maps are made anew unless a scene says otherwise.
    """

    name: str
    where: str
    packs_nodes: bool = False
    holds_volume: bool = True
    refresh_travel: float = 0.05

    def simulation(self, scene, cloud=None):
        """The simulation of a resolved scene; cloud: its node cloud where there is one already."""
        module, name = self.where.split(":")
        return getattr(import_module(module), name)(scene, cloud)


RUNGS: dict[str, Rung] = {
    rung.name: rung
    for rung in (
        Rung("membrane", "taichi_eye.solver.reduced:Membrane", holds_volume=False),
        Rung("cavity", "taichi_eye.solver.reduced:Cavity"),
        Rung("added_mass", "taichi_eye.solver.reduced:AddedMass", packs_nodes=True, refresh_travel=0.5),
        Rung("mfpm", "taichi_eye.solver.simulation:Simulation", packs_nodes=True),
    )
}


def refresh_travel(fidelity: str) -> float:
    """The `Rung.refresh_travel` of a fidelity; "auto", which sets its own, has that of the full model."""
    return RUNGS.get(fidelity, RUNGS["mfpm"]).refresh_travel
