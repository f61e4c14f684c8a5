"""Tissue laws: each a file of its own, all in the table LAWS (`taichi_eye.eye.laws.law` says what one is)."""

from taichi_eye.eye.laws import exponential, film
from taichi_eye.eye.laws.law import Functions, Law

LAWS: dict[str, Law] = {law.name: law for law in (exponential.LAW, film.LAW)}


def law_of(cornea) -> tuple[Law, tuple[float, ...]]:
    """The law of a scene's cornea section, and the constants that `Law.coefficients` takes."""
    return LAWS["exponential"], (cornea.stiffness_a_pa, cornea.exponent_k, cornea.poisson_ratio)


__all__ = ["LAWS", "Functions", "Law", "law_of"]
