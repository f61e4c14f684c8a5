"""Sound speed: the compliance of the sealed chamber against c, from 3 to 300 m/s.

The chamber gives way by dV/V = p / (rho c^2), so peak and half-height times approach their incompressible values as
c^-2; the number of steps, and the run time, grow as c. The incompressible peak of the default eye is 0.959 mm, with
half heights at 9.40 and 20.66 ms, and 0.97 / 1.06 / 1.28 / 1.55 / 1.88 mm are the peaks at c = 30 / 10 / 5 / 3 / 2 m/s,
by an independent solution with potential flow (0.956 mm with a uniform chamber pressure).
"""

import numpy as np

from taichi_eye.proof.maps.result import Map, finish, panels
from taichi_eye.proof.maps.runs import run

SPEEDS = (3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0, 80.0, 120.0, 200.0, 300.0)
FIT = 20.0  # m/s: from here on the law is fitted
POTENTIAL_FLOW = {30.0: 0.97, 10.0: 1.06, 5.0: 1.28, 3.0: 1.55}
INCOMPRESSIBLE = 0.959


def sound_speed(say=print) -> Map:
    """Peak, half-height times and run time of the default puff against c."""
    runs, broken = {}, []
    run({"numerics.duration_ms": 0.1})  # compiles, so that no run time holds it
    for c in SPEEDS:
        runs[c] = each = run({"numerics.sound_speed_m_s": c})
        apex = each.apex
        say(f"  c {c:5g} m/s: peak {apex.peak:.4f} mm, {each.solver_s:.1f} s" + (f", {each.stop}" if each.stop else ""))
    sound = {c: each for c, each in runs.items() if each.stop is None}
    speeds = np.array(sorted(sound))
    peaks = np.array([sound[c].apex.peak for c in speeds])
    rises, falls = (
        np.array([getattr(sound[c].apex, name) for c in speeds]) for name in ("half_rise_ms", "half_fall_ms")
    )
    stiff = speeds >= FIT
    laws = {
        name: np.polyfit(speeds[stiff] ** -2, values[stiff], 1)
        for name, values in (("peak", peaks), ("rise", rises), ("fall", falls))
    }
    order = -np.polyfit(
        np.log(speeds[stiff & (speeds <= 120.0)]), np.log(np.abs(peaks - laws["peak"][1])[stiff & (speeds <= 120.0)]), 1
    )[0]
    canvas, ((left, middle), (right, last)) = panels(2, 2)
    fine = np.geomspace(SPEEDS[0], SPEEDS[-1], 200)
    left.plot(speeds, peaks, "o", color="#14539a", label="computed")
    left.plot(
        fine,
        np.polyval(laws["peak"], fine**-2),
        color="#14539a",
        linewidth=1,
        label=f"{laws['peak'][1]:.4f} mm + {laws['peak'][0]:.3g} / c$^2$",
    )
    left.plot(
        list(POTENTIAL_FLOW),
        list(POTENTIAL_FLOW.values()),
        "x",
        color="#c9641a",
        markersize=9,
        label="potential flow, independent",
    )
    left.axhline(INCOMPRESSIBLE, color="#3d8b57", linestyle="--", linewidth=1, label="incompressible, 0.959 mm")
    left.set_ylim(0.9, 1.7)
    finish(left, "apex peak, h 0.28 mm", "c (m/s)", "mm", log="x")
    middle.plot(speeds, peaks / laws["peak"][1] - 1.0, "o", color="#14539a", label="computed")
    middle.plot(fine, laws["peak"][0] / laws["peak"][1] / fine**2, color="#14539a", linewidth=1, label="c$^{-2}$ law")
    for c, name in ((40.0, "configs/quick.toml"), (80.0, "default")):
        middle.axvline(c, color="#8a9199", linestyle=":", linewidth=1)
        middle.text(
            c,
            0.03,
            name,
            rotation=90,
            ha="right",
            va="bottom",
            fontsize=8,
            color="#4c5560",
            transform=middle.get_xaxis_transform(),
        )
    finish(middle, f"excess of the peak: measured order {order:.2f}", "c (m/s)", "over the limit", log="xy")
    for name, values, colour in (("rise", rises, "#14539a"), ("fall", falls, "#c9641a")):
        right.plot(speeds, values - laws[name][1], "o", color=colour, label=f"{name}, limit {laws[name][1]:.3f} ms")
        right.plot(fine, np.polyval(laws[name], fine**-2) - laws[name][1], color=colour, linewidth=1)
    right.set_ylim(
        min(-1.0, 1.1 * float((rises - laws["rise"][1]).min())), 1.1 * max(1.0, float((falls - laws["fall"][1]).max()))
    )
    finish(right, "half-height times less their limits", "c (m/s)", "ms", log="x")
    last.plot(speeds, [sound[c].solver_s for c in speeds], "o", color="#14539a", label="wall clock (s)")
    last.plot(speeds, [sound[c].steps / 1e4 for c in speeds], "s", color="#c9641a", label="steps (10$^4$)")
    last.plot(
        fine,
        sound[speeds[-1]].steps / 1e4 * fine / speeds[-1],
        "--",
        color="#c9641a",
        linewidth=1,
        label="proportional to c",
    )
    finish(last, "cost of 32 ms", "c (m/s)", "s, 10$^4$ steps", log="xy")
    for c, each in runs.items():
        if each.stop is None and c >= 10.0 and abs(each.apex.peak / np.polyval(laws["peak"], c**-2) - 1.0) > 0.03:
            broken.append(f"c {c:g}: peak {each.apex.peak:.4f} mm is off the c^-2 law, and no guard spoke")
        if c in POTENTIAL_FLOW and each.stop is None and abs(each.apex.peak / POTENTIAL_FLOW[c] - 1.0) > 0.03:
            broken.append(f"c {c:g}: peak {each.apex.peak:.4f} mm, potential flow gives {POTENTIAL_FLOW[c]:g}")
    stops = [f"c {c:g}: {each.stop}" for c, each in runs.items() if each.stop]
    found = [
        f"The excess of the peak goes as c^-{order:.2f} from {FIT:g} m/s on: "
        f"{laws['peak'][0] / laws['peak'][1]:.3g}/c^2 of "
        f"it, {100 * laws['peak'][0] / laws['peak'][1] / 80.0**2:.2f} % at the default 80 m/s and "
        f"{100 * laws['peak'][0] / laws['peak'][1] / 40.0**2:.2f} % at 40.",
        f"Limits at h 0.28 mm: {laws['peak'][1]:.4f} mm (incompressible reference 0.959), half heights "
        f"{laws['rise'][1]:.3f} and {laws['fall'][1]:.3f} ms (9.40, 20.66).",
        "Below about 10 m/s the numbers are those of a compliant chamber, not of an eye: "
        f"{sound[speeds[0]].apex.peak:.2f} mm at "
        f"c {speeds[0]:g}, half heights {sound[speeds[0]].apex.half_rise_ms - laws['rise'][1]:+.1f} and "
        f"{sound[speeds[0]].apex.half_fall_ms - laws['fall'][1]:+.1f} ms off. No guard "
        "speaks, since c is the user's choice of compliance; the volume error in the traces shows it.",
        *stops,
    ]
    head = ("c, m/s", "peak, mm", "50 % rise, ms", "50 % fall, ms", "largest volume error", "steps", "s")
    body = [
        (
            f"{c:g}",
            f"{each.apex.peak:.4f}",
            f"{each.apex.half_rise_ms:.3f}",
            f"{each.apex.half_fall_ms:.3f}",
            f"{np.abs(each.traces['chamber_volume_error']).max():.2e}",
            str(each.steps),
            f"{each.solver_s:.1f}",
        )
        for c, each in sound.items()
    ]
    figures = {
        "order": float(order),
        "peak_limit_mm": float(laws["peak"][1]),
        "rise_limit_ms": float(laws["rise"][1]),
        "fall_limit_ms": float(laws["fall"][1]),
        "peak_mm": {f"{c:g}": each.apex.peak for c, each in sound.items()},
    }
    return Map("sound-speed", canvas, found, head, body, figures, broken)
