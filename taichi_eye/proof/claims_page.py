"""The page of `taichi-eye claims`: verdicts on the paper's claims, four figures, and the table of all runs."""

from __future__ import annotations

import base64
import csv
import html
import io
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from taichi_eye.estimation.bounds import of_own_eye
from taichi_eye.estimation.unknowns import IN_PLANE, IOP, PUFF, own_values
from taichi_eye.ladder.rungs import with_numerics
from taichi_eye.proof import clinic
from taichi_eye.proof.claims import (
    ENERGY_SHARE,
    FRAME_MS,
    UNKNOWN,
    UNKNOWNS,
    Answer,
    Results,
    delays,
    likeness,
    quasi_static,
)
from taichi_eye.proof.measures import measure
from taichi_eye.report.folder import write_text
from taichi_eye.report.page import footer
from taichi_eye.scene import load_scene

ODD = 0.02  # share of the odd part from which a history counts as asymmetric; deflections of eyes have 0.05 to 0.07
HISTORY_ERROR_UM = 25.0  # by which independent models of the same eyes differ
MARKED = 0.1  # change of the peak that counts as marked
INK, BLUE, ORANGE, GREEN, GREY, RED = "#22262b", "#14539a", "#c9641a", "#3d8b57", "#8a9199", "#b3261e"


@dataclass(frozen=True)
class Verdict:
    """A claim, whether it holds in the model, and the figures that say so."""

    claim: str
    holds: str
    why: str


def verdicts(results: Results) -> list[Verdict]:
    """The five claims and the clinical delay, judged from the answers."""
    return [
        _lag(results),
        _asymmetry(results),
        _cause(results),
        _influence(results),
        _pressure(results),
        _clinical(results),
    ]


def _lag(results: Results) -> Verdict:
    base = results.base
    largest = max(abs(delay) for name, delay in base.delays.items() if name != "peak")
    holds = "yes" if largest > FRAME_MS and min(base.delays.values()) > 0.0 else "no"
    corvis = _one(results, "measured puff")
    why = (
        f"Sealed default eye, Gaussian puff: {_delays(base)} behind the puff; one frame of the camera is {FRAME_MS:g} "
        f"ms. The peak's time is ill conditioned: the dent stays within 1 % of its peak for {_flat(base):.1f} ms."
    )
    if corvis is not None:
        slow = _beyond_static(results, corvis)
        why += (
            f" Under the measured, asymmetric puff the apex is {slow['midpoint']:+.2f} ms (50 % midpoint), "
            f"{slow['centroid']:+.2f} ms (centroid) and {slow['peak']:+.2f} ms (peak) behind its own quasi-static "
            "answer."
        )
    soft = [o for o in results.of("sound speed") if o.measures and o.case.value <= 10.0]
    if soft:
        why += (
            " A fluid made too soft deepens the dent without delaying it much: "
            + "; ".join(
                f"c {o.case.value:g} m/s {o.peak_mm:.2f} mm, {o.delays['midpoint']:+.2f} ms "
                f"midpoint, {o.delays['peak']:+.2f} ms "
                "peak"
                for o in soft
            )
            + "."
        )
    return Verdict("(i) the apex lags the jet", holds, why)


def _asymmetry(results: Results) -> Verdict:
    m = results.base.measures
    corvis = _one(results, "measured puff")
    why = (
        f"Gaussian puff: fall : rise {m.fall_to_rise:.2f}, outward : inward speed {m.speed_ratio:.2f}, skewness "
        f"{m.skewness:+.3f}, odd part {100 * m.odd_share:.1f} % of the history."
    )
    if corvis is not None:
        static = measure(corvis.time_ms, quasi_static(results.base, corvis.load_kpa))
        load = measure(corvis.time_ms, corvis.load_kpa)
        why += (
            f" Under the measured puff, itself asymmetric (fall : rise {load.fall_to_rise:.2f}, odd part "
            f"{100 * load.odd_share:.1f} %), the apex has {corvis.measures.fall_to_rise:.2f} and "
            f"{100 * corvis.measures.odd_share:.1f} %; without any inertia it would have "
            f"{static.fall_to_rise:.2f} and {100 * static.odd_share:.1f} %; on eyes "
            f"{np.mean(clinic.DEFLECTION['fall_to_rise']):.2f} and "
            f"{100 * np.mean(clinic.DEFLECTION['odd_share']):.1f} % "
            f"(deflection), {np.mean(clinic.DEFORMATION['fall_to_rise']):.2f} and "
            f"{100 * np.mean(clinic.DEFORMATION['odd_share']):.1f} % (deformation). So that "
            "asymmetry is the puff's and "
            "the globe's."
        )
    return Verdict("(ii) its history is not symmetric in time", "yes" if m.odd_share > ODD else "no", why)


def _cause(results: Results) -> Verdict:
    base = results.base
    lines = [f"default: midpoint {base.delays['midpoint']:+.3f} ms, odd part {100 * base.measures.odd_share:.2f} %"]
    for study in ("fluid density", "cornea density", "viscosity", "viscosity, no slip", "open", "open, light fluid"):
        for o in results.of(study):
            if o.sound:
                lines.append(f"{o.case.label}: {o.delays['midpoint']:+.3f} ms, {100 * o.measures.odd_share:.2f} %")
    light = [o for o in results.of("fluid density") if o.sound and o.case.value < 0.5]
    solid = [o for o in results.of("cornea density") if o.sound]
    part = min((o.measures.odd_share for o in light), default=math.nan) / base.measures.odd_share
    cornea = min((o.measures.odd_share for o in solid), default=math.nan) / base.measures.odd_share
    thick = [o for o in results.of("viscosity") if o.sound]
    drag = max((abs(o.delays["midpoint"] - base.delays["midpoint"]) for o in thick), default=math.nan)
    why = (
        "The little there is goes away with the mass of either: a lighter fluid leaves "
        f"{100 * part:.0f} % of the odd part, "
        f"a cornea of a tenth of its mass {100 * cornea:.0f} %. It is the coupled mode, rung by the puff, not a drag: "
        f"viscosities of {', '.join(f'{o.case.value:g}' for o in thick)} mPa s move the midpoint "
        f"by at most {drag:.3f} ms. " + "; ".join(lines) + "."
    )
    left_out = [o.case.label for o in results.of("viscosity, no slip") if not o.sound]
    if left_out:
        why += f" Not concluded from, for its energy balance: {', '.join(left_out)}."
    return Verdict("(iii) both come from the fluid", "in part" if part < 0.5 else "no", why)


def _influence(results: Results) -> Verdict:
    base = results.base
    ratios = []
    for sealed, open_ in zip(results.of("sealed"), results.of("open")):
        if sealed.measures and open_.measures:
            ratios.append((sealed.case.value, open_.peak_mm / sealed.peak_mm, sealed.peak_mm, open_.peak_mm))
    why = "Through its volume: " + "; ".join(
        f"at {kpa:g} kPa {deep:.2f} mm open, {shut:.2f} mm sealed ({ratio:.2f} times)"
        for kpa, ratio, shut, deep in ratios
    )
    why += "; ".join([""] + [f"{o.case.label}: {o.stop}" for o in results.of("open") if o.stop])
    light = [o for o in results.of("fluid density") if o.sound]
    why += (
        (
            ". Hardly through its flow: "
            + ", ".join(f"{o.case.label} {100 * (o.peak_mm / base.peak_mm - 1):+.1f} %" for o in light)
            + " in the peak of the sealed eye."
        )
        if light
        else "."
    )
    marked = any(ratio > 1.0 + MARKED for _, ratio, _, _ in ratios)
    return Verdict("(iv) the fluid influences the motion markedly", "yes, by its volume" if marked else "no", why)


def _pressure(results: Results) -> Verdict:
    iop, peak = results.pressure_curve()
    here = load_scene().eye.iop_mmhg
    table = results.elasticities()
    slope = table["IOP"]["peak"] * results.base.peak_mm / here
    why = (
        f"The peak falls from {peak[0]:.2f} to {peak[-1]:.2f} mm over {iop[0]:g} to {iop[-1]:g} "
        f"mmHg: {slope:.3f} mm/mmHg "
        f"at {here:g} mmHg (deformation over 194 eyes: {clinic.AMPLITUDE_PER_MMHG:.3f}). With the tissue taken for the "
        "default, the peak reads an IOP off by "
    )
    errors = []
    for name in UNKNOWNS:
        pair = [o for o in results.of(name) if o.sound]
        seen = [results.pressure_seen(o) - here for o in pair]
        if seen:
            errors.append(
                f"{' / '.join(f'{e:+.2f}' for e in seen)} mmHg where {_NAMES[name]} is "
                f"{' / '.join(f'{100 * o.case.value:+.0f} %' for o in pair)}"
            )
    clinical = clinic.AMPLITUDE_PER_10_UM * load_scene().cornea.thickness_mm * UNKNOWN * 100.0
    why += ", ".join(errors) + (
        f"; the spread of the instrument's own puff, {100 * clinic.PUFF_SPREAD:.1f} %, is a "
        f"{_puff_error(results):.2f} mmHg. "
        "Likeness of what they do to the history (cosine; +-1: not to be told apart): "
        + ", ".join(f"IOP and {_NAMES[name]} {likeness(table['IOP'], table[name]):+.2f}" for name in UNKNOWNS)
        + f". A membrane carries the IOP whatever its thickness; on eyes 10 % of thickness changes the amplitude by "
        f"{clinical:+.3f} mm, {abs(clinical / clinic.AMPLITUDE_PER_MMHG):.1f} mmHg worth, which "
        "bending would have to explain: "
        f"the model understates this error. {_whole_history()}"
    )
    return Verdict("(v) the IOP can be estimated from the motion", "yes, as well as model and puff are known", why)


def _whole_history() -> str:
    """What the paper hoped for, with `taichi-eye estimate`: how well a whole history can tell the IOP of this eye."""
    scene = with_numerics(load_scene(None, ["puff.time_course=corvis"]), fidelity="cavity")
    known = {name: value for name, value in own_values(scene).items() if name != IOP}
    tissue = {name: value for name, value in known.items() if name != IN_PLANE}
    puff = tissue | {PUFF: (1.0, clinic.PUFF_SPREAD)}
    alone, soft, blown = (of_own_eye(scene, one) for one in (known, tissue, puff))
    nothing, wrong = of_own_eye(scene, {}), of_own_eye(scene, {}, model_error_um=HISTORY_ERROR_UM)
    return (
        "Fitted as a whole, a history of 139 values with 10 um of noise under the measured puff can tell the IOP of "
        f"this eye to {alone:.2f} mmHg where all else is known, {soft:.2f} with its stiffness unknown, {blown:.2f} "
        f"with the puff known to {100 * clinic.PUFF_SPREAD:.1f} % as well, {nothing:.2f} with a population for the "
        f"rest, and {wrong:.2f} where the model is wrong by {HISTORY_ERROR_UM:g} um: not the camera is the limit "
        "(standard "
        "deviations, bound of Cramer and Rao; what estimates come to: `taichi-eye docs estimate`)."
    )


def _puff_error(results: Results) -> float:
    table = results.elasticities()
    return abs(table["puff"]["peak"] / table["IOP"]["peak"]) * clinic.PUFF_SPREAD * load_scene().eye.iop_mmhg


def _clinical(results: Results) -> Verdict:
    corvis = _one(results, "measured puff")
    if corvis is None:
        return Verdict("the measured delay", "not judged", "The run with the measured puff did not go through.")
    load = measure(corvis.time_ms, corvis.load_kpa)
    globe = measure(corvis.time_ms, corvis.apex_mm + clinic.whole_eye(corvis.time_ms))
    rows = []
    for name, attribute in (("midpoint", "midpoint_ms"), ("centroid", "centroid_ms"), ("peak_time", "peak_time_ms")):
        puff = getattr(load, attribute)
        whole, cornea = np.mean(clinic.DEFORMATION[name]) - puff, np.mean(clinic.DEFLECTION[name]) - puff
        rows.append(
            f"{name.replace('_', ' ')}: deformation {whole:+.2f} ms behind the puff on eyes, of "
            "which the globe's retreat "
            f"{whole - cornea:+.2f} and the cornea {cornea:+.2f}; model "
            f"{getattr(corvis.measures, attribute) - puff:+.2f} "
            f"(limbus fixed) and {getattr(globe, attribute) - puff:+.2f} with the measured retreat added"
        )
    fluid = _beyond_static(results, corvis)
    moved = [np.mean(clinic.DEFORMATION[name]) - np.mean(clinic.DEFLECTION[name]) for name in ("midpoint", "centroid")]
    holds = "the globe moves" if min(moved) > 2.0 * max(fluid["midpoint"], fluid["centroid"]) else "not the globe alone"
    why = (
        ". ".join(rows)
        + ". The fluid's share is what the model has beyond the quasi-static answer: "
        + ", ".join(f"{name} {value:+.2f} ms" for name, value in fluid.items())
    )
    return Verdict(
        "the delay measured on eyes",
        holds,
        why + ". What the deflection of eyes has more than the model, in midpoint "
        "and centroid, the fluid does not explain either: the model's tissue has no viscosity, and the clocks of puff "
        "and film may differ by as much.",
    )


_NAMES = {
    "exponent": "the exponent k",
    "stiffness": "the stiffness at rest",
    "thickness": "the thickness",
    "puff": "the puff's strength",
}


def _one(results: Results, study: str) -> Answer | None:
    found = [o for o in results.of(study) if o.sound]
    return found[0] if found else None


def _delays(answer: Answer) -> str:
    words = {"midpoint": "50 % midpoint", "centroid": "centroid", "match": "best match", "peak": "fitted peak"}
    return ", ".join(f"{words[name]} {value:+.3f} ms" for name, value in answer.delays.items())


def _flat(answer: Answer) -> float:
    high = answer.time_ms[answer.apex_mm > 0.99 * answer.apex_mm.max()]
    return float(high[-1] - high[0])


def _beyond_static(results: Results, answer: Answer) -> dict[str, float]:
    static = delays(answer.time_ms, quasi_static(results.base, answer.load_kpa), answer.load_kpa)
    return {name: answer.delays[name] - static[name] for name in ("midpoint", "centroid", "peak")}


# --- figures --------------------------------------------------------------------------------------------------------


def figures(results: Results) -> dict[str, Figure]:
    """The page's figures by title."""
    return {
        "Apex histories": _histories(results),
        "Delay and asymmetry": _sweeps(results),
        "The delay measured on eyes": _eyes(results),
        "IOP from the motion": _iop(results),
    }


def _histories(results: Results) -> Figure:
    figure = Figure(figsize=(11, 4.2), dpi=110, layout="constrained")
    left, right = figure.subplots(1, 2)
    base = results.base
    left.fill_between(
        base.time_ms, base.load_kpa / base.load_kpa.max(), color=ORANGE, alpha=0.12, linewidth=0, label="puff"
    )
    shown = [
        (base, BLUE, "default"),
        *[
            (o, colour, o.case.label)
            for o, colour in zip(
                results.of("sound speed")[:1] + results.of("fluid density")[:1] + results.of("fluid density")[-1:],
                (GREEN, RED, GREY),
            )
        ],
    ]
    for o, colour, label in shown:
        left.plot(o.time_ms, o.apex_mm / o.peak_mm, color=colour, linewidth=1.5, label=label)
    _dress(left, "time (ms)", "over its peak", "sealed chamber: shape")
    for o in results.of("sealed") + results.of("open"):
        colour = BLUE if o.case.study == "sealed" else RED
        right.plot(o.time_ms, o.apex_mm, color=colour, linewidth=1.0 + 0.15 * o.case.value)
        right.annotate(
            f"{o.case.value:g} kPa",
            (o.time_ms[np.argmax(o.apex_mm)], o.peak_mm),
            (18 if o.case.study == "open" else -18, 3),
            textcoords="offset points",
            ha="center",
            fontsize=8.5,
            color=colour,
        )
        if o.stop:
            right.plot(o.time_ms[-1], o.apex_mm[-1], "x", color=RED, markersize=9, markeredgewidth=2)
    right.plot([], [], color=BLUE, label="sealed")
    right.plot([], [], color=RED, label="open (mean pressure at the IOP)")
    right.plot([], [], "x", color=RED, label="stopped: the back is reached")
    _dress(right, "time (ms)", "apex displacement (mm)", "sealed and open chamber")
    return figure


def _sweeps(results: Results) -> Figure:
    figure = Figure(figsize=(11, 6.2), dpi=110, layout="constrained")
    axes = figure.subplots(2, 3, sharey="row")
    mu = load_scene().aqueous.viscosity_mpa_s
    columns = (
        ("sound speed c (m/s)", results.with_base("sound speed", load_scene().numerics.sound_speed_m_s)),
        (
            "fluid density, times 1000 kg/m\N{SUPERSCRIPT THREE}; rho c\N{SUPERSCRIPT TWO} kept",
            results.with_base("fluid density", 1.0),
        ),
        ("viscosity (mPa s), slip", [o for o in results.with_base("viscosity", mu) if _place(o, mu) > 0]),
    )
    for column, (label, answers) in enumerate(columns):
        own = (load_scene().numerics.sound_speed_m_s, 1.0, mu)[column]
        at = [_place(o, own) for o in answers]
        top, low = axes[0, column], axes[1, column]
        for name, colour, marker in (
            ("midpoint", BLUE, "o"),
            ("centroid", GREEN, "s"),
            ("match", GREY, "^"),
            ("peak", ORANGE, "x"),
        ):
            top.plot(
                at,
                [o.delays[name] for o in answers],
                color=colour,
                marker=marker,
                markersize=5,
                linewidth=1.2,
                label={"midpoint": "50 % midpoint", "match": "best match", "peak": "fitted peak"}.get(name, name),
            )
        top.axhspan(-FRAME_MS, FRAME_MS, color=GREY, alpha=0.12, linewidth=0, label="within one camera frame")
        low.plot(
            at,
            [100 * o.measures.odd_share for o in answers],
            color=BLUE,
            marker="o",
            markersize=5,
            label="odd part (%)",
        )
        low.plot(
            at,
            [100 * o.measures.skewness for o in answers],
            color=GREEN,
            marker="s",
            markersize=5,
            label="skewness x 100",
        )
        low.plot(
            at,
            [10 * math.log(o.measures.fall_to_rise) for o in answers],
            color=ORANGE,
            marker="x",
            markersize=5,
            label="ln(fall : rise) x 10",
        )
        low.plot(
            at,
            [10 * math.log(o.measures.speed_ratio) for o in answers],
            color=GREY,
            marker="^",
            markersize=5,
            label="ln(outward : inward speed) x 10",
        )
        for each in (top, low):
            each.set_xscale("log")
            each.axvline(own, color=INK, linewidth=0.6, linestyle=":")
            each.axhline(0.0, color=INK, linewidth=0.6)
        _dress(top, "", "behind the puff (ms)" if column == 0 else "", "", legend=column == 0)
        _dress(low, label, "asymmetry" if column == 0 else "", "", legend=column == 0)
    return figure


def _place(answer: Answer, own: float) -> float:
    return own if answer.case.study == "reference" else answer.case.value


def _eyes(results: Results) -> Figure:
    figure = Figure(figsize=(11, 4.2), dpi=110, layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    corvis = _one(results, "measured puff")
    if corvis is None:
        left.text(0.5, 0.5, "the run with the measured puff was stopped", ha="center", transform=left.transAxes)
        return figure
    t, load = corvis.time_ms, measure(corvis.time_ms, corvis.load_kpa)
    static, globe = quasi_static(results.base, corvis.load_kpa), clinic.whole_eye(t)
    left.fill_between(
        t,
        corvis.load_kpa / corvis.load_kpa.max(),
        color=ORANGE,
        alpha=0.12,
        linewidth=0,
        label="puff measured (over its peak)",
    )
    left.plot(t, static, color=GREY, linewidth=1.2, linestyle="--", label="model, quasi-static")
    left.plot(t, corvis.apex_mm, color=BLUE, linewidth=1.8, label="model (limbus fixed): deflection")
    left.plot(t, globe, color=GREEN, linewidth=1.2, label="whole eye, measured, mean of 3")
    left.plot(t, corvis.apex_mm + globe, color=RED, linewidth=1.8, label="sum: deformation")
    for values, colour, label in (
        (clinic.DEFLECTION, BLUE, "3 eyes: peak of deflection"),
        (clinic.DEFORMATION, RED, "3 eyes: peak of deformation"),
    ):
        left.plot(
            values["peak_time"], values["peak"], "o", color=colour, markersize=5, markeredgecolor="white", label=label
        )
    _dress(left, "time (ms)", "displacement (mm)", "")
    left.set_ylim(-0.05, 1.45)
    names = (
        ("50 % midpoint", "midpoint", "midpoint_ms"),
        ("centroid", "centroid", "centroid_ms"),
        ("peak", "peak_time", "peak_time_ms"),
    )
    both = measure(t, corvis.apex_mm + globe)
    for row, (_, key, attribute) in enumerate(names):
        puff = getattr(load, attribute)
        for values, colour, shift in ((clinic.DEFORMATION, RED, 0.12), (clinic.DEFLECTION, BLUE, -0.12)):
            right.plot(
                np.array(values[key]) - puff,
                [row + shift] * 3,
                "o",
                color=colour,
                markersize=5,
                markeredgecolor="white",
            )
        right.plot(getattr(both, attribute) - puff, row + 0.12, "|", color=RED, markersize=18, markeredgewidth=2.5)
        right.plot(
            getattr(corvis.measures, attribute) - puff, row - 0.12, "|", color=BLUE, markersize=18, markeredgewidth=2.5
        )
    right.plot([], [], "o", color=INK, label="3 eyes")
    right.plot([], [], "|", color=INK, markersize=12, markeredgewidth=2.5, label="model")
    right.axvline(0.0, color=INK, linewidth=0.6)
    right.set_yticks(range(3), [label for label, _, _ in names])
    right.set_ylim(2.6, -0.6)
    _dress(right, "behind the puff (ms); red deformation, blue deflection", "", "")
    return figure


def _iop(results: Results) -> Figure:
    figure = Figure(figsize=(11, 4.0), dpi=110, layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(2, 3))
    iop, peak = results.pressure_curve()
    left.plot(iop, peak, color=BLUE, marker="o", markersize=5, label="default tissue and puff")
    here = load_scene().eye.iop_mmhg
    for name, colour, marker in zip(UNKNOWNS, (GREEN, RED, GREY, ORANGE), "s^Dx"):
        pair = [o for o in results.of(name) if o.sound]
        left.plot(
            [here] * len(pair),
            [o.peak_mm for o in pair],
            marker,
            color=colour,
            markersize=6,
            label=f"{_NAMES[name]} +-{100 * UNKNOWN:.0f} %",
        )
    _dress(left, "IOP (mmHg)", "peak of the apex (mm)", "")
    table = results.elasticities()
    features = list(table["IOP"])
    width = 0.8 / len(table)
    for row, (name, values) in enumerate(table.items()):
        right.bar(
            np.arange(len(features)) + width * (row - 0.5 * (len(table) - 1)),
            [values[f] for f in features],
            width,
            color=(BLUE, GREEN, RED, GREY, ORANGE)[row],
            label={"IOP": "IOP", **_NAMES}[name],
        )
    short = [f.replace(" before the puff's", "\nbefore").replace(" after the puff's", "\nafter") for f in features]
    right.set_xticks(range(len(features)), short, fontsize=8)
    right.axhline(0.0, color=INK, linewidth=0.7)
    _dress(right, "", "% change per % of the parameter", "")
    return figure


def _dress(axes, x: str, y: str, title: str, legend: bool = True) -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    if title:
        axes.set_title(title, fontsize=10)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    if legend:
        axes.legend(frameon=False, fontsize=8)


# --- files ----------------------------------------------------------------------------------------------------------

_STYLE = """body{font:15px/1.5 system-ui,sans-serif;color:#22262b;max-width:1150px;margin:2em auto;padding:0 1em}
h1{font-size:1.5em}h2{font-size:1.15em;margin-top:2em}img{max-width:100%}table{border-collapse:collapse}
td,th{text-align:left;vertical-align:top;padding:.35em .7em;border-bottom:1px solid #dde1e5}
.runs{font-size:12px;font-variant-numeric:tabular-nums}.runs td,.runs th{padding:.15em .5em}.verdict{font-weight:600}"""
_SHOWN = (
    ("case", "case", ""),
    ("peak_mm", "peak mm", ".4f"),
    ("delay_midpoint_ms", "midpoint ms", "+.3f"),
    ("delay_centroid_ms", "centroid ms", "+.3f"),
    ("delay_match_ms", "match ms", "+.3f"),
    ("delay_peak_ms", "peak ms", "+.3f"),
    ("fall_to_rise", "fall : rise", ".3f"),
    ("skewness", "skewness", "+.4f"),
    ("speed_ratio", "out : in", ".3f"),
    ("odd_share", "odd part", ".4f"),
    ("volume_change", "volume", "+.4f"),
    ("energy_error", "energy", ".4f"),
    ("stopped", "stopped", ""),
)


def page(results: Results, spacing_mm: float) -> str:
    """The whole page as self-contained HTML."""
    rows = "".join(
        f"<tr><td>{html.escape(v.claim)}</td><td class=verdict>{html.escape(v.holds)}</td>"
        f"<td>{html.escape(v.why)}</td></tr>"
        for v in verdicts(results)
    )
    plots = "".join(
        f"<h2>{html.escape(title)}</h2><img alt='{html.escape(title)}' src='data:image/png;base64,{_png(figure)}'>"
        for title, figure in figures(results).items()
    )
    head = "".join(f"<th>{title}</th>" for _, title, _ in _SHOWN)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(_cell(row[name], form))}</td>" for name, _, form in _SHOWN) + "</tr>"
        for row in (o.row() for o in results.answers)
    )
    return (
        "<!doctype html><html lang=en><meta charset=utf-8><title>The paper's claims, "
        f"tested</title><style>{_STYLE}</style>"
        "<h1>The paper's claims, tested in the model</h1><p>Montanino, Angelillo and Pandolfi, A mesh-free approach to "
        "cornea-aqueous humor interaction during tonometry tests. Every statement below is "
        "about this model: a membrane "
        "cornea with a fixed limbus over a weakly compressible fluid. "
        f"Node spacing {spacing_mm:g} mm. Delays have the puff's own measure subtracted; where the fluid's density "
        "changes, c goes as its inverse root, so that rho c<sup>2</sup> stays. Nothing is "
        "concluded from a run that was "
        f"stopped or whose energy balance is off by more than {100 * ENERGY_SHARE:g} % of the puff's work.</p>"
        f"<table><tr><th>claim</th><th>holds</th><th>by how much</th></tr>{rows}</table>{plots}"
        "<h2>All runs</h2><p>Delays behind the puff by four measures; fall : rise about the "
        "fitted peak; skewness of what "
        "stands above 10 % of the peak; largest outward over inward speed; odd part about the midpoint over the whole "
        "(rms); volume: largest loss; energy: largest error over the puff's work.</p>"
        f"<table class=runs><tr>{head}</tr>{body}</table>{footer()}</html>\n"
    )


def _cell(value, form: str) -> str:
    return "" if value is None else format(value, form) if form else str(value)


def _png(figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", facecolor="white")
    return base64.b64encode(buffer.getvalue()).decode("ascii")


def table(answers: Sequence[Answer]) -> str:
    """All rows as CSV text."""
    rows = [o.row() for o in answers]
    out = io.StringIO()
    writer = csv.DictWriter(out, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()


def as_json(results: Results) -> str:
    """Verdicts, sensitivities and all rows as JSON text."""
    return (
        json.dumps(
            {
                "claims": [{"claim": v.claim, "holds": v.holds, "why": v.why} for v in verdicts(results)],
                "elasticities": results.elasticities(),
                "runs": [o.row() for o in results.answers],
            },
            indent=2,
        )
        + "\n"
    )


def write(results: Results, folder: Path, spacing_mm: float) -> Path:
    """Write claims.html and claims.csv into the folder; returns the page's path."""
    write_text(folder / "claims.csv", table(results.answers))
    write_text(folder / "claims.html", page(results, spacing_mm))
    return folder / "claims.html"
