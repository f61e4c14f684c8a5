"""Tissue laws: each a file of its own, all in the table LAWS (`taichi_eye.eye.laws.law` says what one is)."""

from taichi_eye.eye.laws import exponential, film
from taichi_eye.eye.laws.law import Functions, Law

LAWS: dict[str, Law] = {law.name: law for law in (exponential.LAW, film.LAW)}

__all__ = ["LAWS", "Functions", "Law"]
