"""One PySPH run of the peer comparison; a script for an environment that has PySPH and not this package.

    python pysph_cases.py CASE SCHEME NX PERTURB     ->  one line of JSON: nodes, steps, seconds, error

taylor-green is PySPH's own example with its own settings (quintic spline, h = dx, its time step, c 10, periodic unit
box, Re 100) to t = 1. standing-wave is the same box at rest with u = A sin(2 pi x), inviscid, over two periods.
seconds: PySPH's solve() alone, neither its set-up nor its compiler. error: L2 norm of the velocity's error over that of
the exact velocity, at the particles.
"""

import json
import sys
import tempfile
import time

import numpy as np
from pysph.examples.taylor_green import TaylorGreen, c0, exact_solution

REYNOLDS, AMPLITUDE, PERIODS = 100.0, 1e-3, 2.0


class StandingWave(TaylorGreen):
    """A plane sound wave between two walls, and its mirror image beyond."""

    def create_fluid(self):
        """Particles on the example's lattice, moving along x."""
        fluid = super().create_fluid()
        fluid.u[:] = AMPLITUDE * np.sin(2.0 * np.pi * fluid.x)
        fluid.v[:] = 0.0
        fluid.p[:] = 0.0
        return fluid


def main(case, scheme, nx, perturb):
    """Run and print."""
    wave = case == "standing-wave"
    app = (StandingWave if wave else TaylorGreen)(fname=case)
    with tempfile.TemporaryDirectory() as folder:
        app.setup(
            [
                "--scheme",
                scheme,
                "--nx",
                nx,
                "--perturb",
                perturb,
                "--re",
                "1e12" if wave else str(REYNOLDS),
                "--tf",
                str(PERIODS / c0) if wave else "1.0",
                "--disable-output",
                "--pfreq",
                "100000000",
                "--openmp",
                "--cache-nnps",
                "-d",
                folder,
            ]
        )
        started = time.perf_counter()
        app.solve()
        took = time.perf_counter() - started
    fluid, at = app.particles[0], app.solver.t
    real = slice(fluid.get_number_of_particles(real=True))
    x, y, u, v = (getattr(fluid, name)[real] for name in "xyuv")
    if wave:
        exact = AMPLITUDE * np.sin(2.0 * np.pi * x) * np.cos(2.0 * np.pi * c0 * at), np.zeros_like(x)
    else:
        exact = exact_solution(1.0, -8.0 * np.pi**2 / REYNOLDS, at, x, y)[:2]
    error = np.sqrt(((u - exact[0]) ** 2 + (v - exact[1]) ** 2).sum() / (exact[0] ** 2 + exact[1] ** 2).sum())
    print(json.dumps({"nodes": len(x), "steps": app.solver.count, "seconds": took, "error": float(error)}))


if __name__ == "__main__":
    main(*sys.argv[1:])
