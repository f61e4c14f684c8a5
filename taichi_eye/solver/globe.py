"""The rest of the globe behind the chamber, for every rung: it takes up liquid as the mean pressure rises, and late.

With C its compliance at rest [m^3/Pa] and p the mean excess pressure it holds y = V(p) in the end: V = C p, or after
Friedenwald, whose globe stiffens in proportion to its pressure P0 + p,

    V = C P0 ln(1 + p / P0),   stored energy  P0 [C P0 (exp(y / (C P0)) - 1) - y],   P0 the pressure at rest;

below p = -0.9 P0, where an eye is all but empty, its tangent goes on. A globe whose wall is viscous follows late,
dy/dt = (V(p) - y) / delay. A step takes the exact answer to a pressure that is that of the step's end throughout: of
the way from what it held to V(p) a share `followed` is done, all of it without a delay. The liquid that it takes up
leaves the chamber from everywhere alike: the eye behind the iris is not resolved.

Energy: the work done on the globe, by the trapezoidal rule, is what it stores, and the rest is lost in its wall.
"""

from taichi_eye.backend import real
from taichi_eye.eye.eye import Eye
from taichi_eye.lang import ti

LOWEST = -0.9  # of P0: below this excess pressure Friedenwald's law goes on as its tangent
NEWTON = 8  # iterations at most, of which a step takes three or four


@ti.data_oriented
class Globe:
    """One globe to an eye, in fields [eyes].

    compliance C [m^3/Pa], delay [s], rest_pressure P0 [Pa], infinite where V = C p; taken_up y [m^3], work done on it
    [J], mean_pressure of the last step [Pa].
    """

    def __init__(self, eyes: int):
        self.compliance, self.delay, self.rest_pressure = (ti.field(real(), eyes) for _ in range(3))
        self.taken_up, self.work, self.mean_pressure = (ti.field(real(), eyes) for _ in range(3))

    def evolving(self) -> dict:
        """The fields that evolve, by name (`taichi_eye.solver.state`)."""
        return {"globe_taken_up": self.taken_up, "globe_work": self.work, "globe_mean_pressure": self.mean_pressure}

    def build(self, eye: Eye, number: int = 0) -> None:
        """Put an eye's globe at rest; number: of the eye."""
        self._build(number, eye.globe_compliance, eye.globe.delay, eye.globe_pressure)

    @ti.kernel
    def _build(self, eye: int, compliance: float, delay: float, rest_pressure: float):
        self.rest(eye, compliance, delay, rest_pressure)

    @ti.func
    def rest(self, eye, compliance, delay, rest_pressure):
        """An eye's globe at rest."""
        self.compliance[eye], self.delay[eye], self.rest_pressure[eye] = compliance, delay, rest_pressure
        self.taken_up[eye], self.work[eye], self.mean_pressure[eye] = 0.0, 0.0, 0.0

    @ti.func
    def followed(self, eye, dt):
        """The share of its way to V(p) that the globe goes in a step of dt [s]."""
        share = 1.0
        if self.delay[eye] > 0.0:
            share = 1.0 - ti.exp(-dt / self.delay[eye])
        return share

    @ti.func
    def uptake(self, eye, share, soft, pressure):
        """share V(p) + soft p at a mean excess pressure p [Pa], and its slope; share: of V, soft [m^3/Pa]: of what
        yields beside the globe."""
        slope = share * self.compliance[eye] + soft
        volume = slope * pressure
        if not ti.math.isinf(self.rest_pressure[eye]):
            ratio = pressure / self.rest_pressure[eye]
            held = ti.max(ratio, LOWEST)
            slope = share * self.compliance[eye] / (1.0 + held) + soft
            full = self.compliance[eye] * self.rest_pressure[eye]
            volume = share * full * (ti.log(1.0 + held) + (ratio - held) / (1.0 + held)) + soft * pressure
        return volume, slope

    @ti.func
    def pressure_for(self, eye, share, soft, volume):
        """The pressure [Pa] at which `uptake` is a volume [m^3]: Newton's iteration from the last step's pressure.

        `uptake` rises and bends downwards, so from below the iteration rises without overshooting, and from above its
        first step leads below.
        """
        pressure = volume / (share * self.compliance[eye] + soft)
        if not ti.math.isinf(self.rest_pressure[eye]):
            pressure = self.mean_pressure[eye]
            for _ in range(NEWTON):
                held, slope = self.uptake(eye, share, soft, pressure)
                change = (volume - held) / slope
                pressure += change
                if ti.abs(change) <= 1e-13 * self.rest_pressure[eye]:
                    break
        return pressure

    @ti.func
    def take_up(self, eye, share, pressure):
        """End a step at a mean excess pressure [Pa]; share: what `followed` said."""
        before = self.taken_up[eye]
        goal, slope = self.uptake(eye, 1.0, 0.0, pressure)
        taken = share * (goal - before)
        self.work[eye] += 0.5 * (self.mean_pressure[eye] + pressure) * taken
        self.taken_up[eye], self.mean_pressure[eye] = before + taken, pressure

    @ti.func
    def stored(self, eye):
        """What the globe stores [J]."""
        energy = 0.0
        if self.compliance[eye] > 0.0:
            energy = 0.5 * self.taken_up[eye] * self.taken_up[eye] / self.compliance[eye]
            if not ti.math.isinf(self.rest_pressure[eye]):
                full = self.compliance[eye] * self.rest_pressure[eye]
                x = self.taken_up[eye] / full
                # exp(x) - 1 - x, by its series where the difference would cancel
                spare = ti.exp(x) - 1.0 - x
                if ti.abs(x) < 0.01:
                    spare = x * x * (0.5 + x * (1.0 / 6.0 + x * (1.0 / 24.0 + x / 120.0)))
                energy = self.rest_pressure[eye] * full * spare
        return energy
