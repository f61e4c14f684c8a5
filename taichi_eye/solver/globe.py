"""The rest of the globe behind the chamber, for every rung: it takes up liquid as the mean pressure rises, and late.

With C its compliance [m^3/Pa] and p the mean excess pressure it holds y in the end, y = C p; a globe whose wall is
viscous follows late, dy/dt = (C p - y) / delay. A step takes the exact answer to a pressure that is that of the step's
end
throughout: of the way from what it held to C p a share `followed` is done, all of it without a delay. The liquid that
it takes up leaves the chamber from everywhere alike: the eye behind the iris is not resolved.

Energy: the work done on the globe, by the trapezoidal rule, is what it stores, y^2 / (2 C), and the rest is lost in its
wall.
"""

from taichi_eye.backend import real
from taichi_eye.lang import ti


@ti.data_oriented
class Globe:
    """One globe to an eye, in fields [eyes].

    compliance C [m^3/Pa], delay [s]; taken_up y [m^3], work done on it [J], mean_pressure of the last step [Pa].
    """

    def __init__(self, eyes: int):
        self.compliance, self.delay, self.taken_up, self.work, self.mean_pressure = (
            ti.field(real(), eyes) for _ in range(5)
        )

    def evolving(self) -> dict:
        """The fields that evolve, by name (`taichi_eye.solver.state`)."""
        return {"globe_taken_up": self.taken_up, "globe_work": self.work, "globe_mean_pressure": self.mean_pressure}

    @ti.func
    def rest(self, eye, compliance, delay):
        """An eye's globe at rest."""
        self.compliance[eye], self.delay[eye] = compliance, delay
        self.taken_up[eye], self.work[eye], self.mean_pressure[eye] = 0.0, 0.0, 0.0

    @ti.func
    def followed(self, eye, dt):
        """The share of its way to C p that the globe goes in a step of dt [s]."""
        share = 1.0
        if self.delay[eye] > 0.0:
            share = 1.0 - ti.exp(-dt / self.delay[eye])
        return share

    @ti.func
    def take_up(self, eye, share, pressure):
        """End a step at a mean excess pressure [Pa]; share: what `followed` said."""
        before = self.taken_up[eye]
        taken = share * (self.compliance[eye] * pressure - before)
        self.work[eye] += 0.5 * (self.mean_pressure[eye] + pressure) * taken
        self.taken_up[eye], self.mean_pressure[eye] = before + taken, pressure

    @ti.func
    def stored(self, eye):
        """What the globe stores [J]."""
        energy = 0.0
        if self.compliance[eye] > 0.0:
            energy = 0.5 * self.taken_up[eye] * self.taken_up[eye] / self.compliance[eye]
        return energy
