"""What a tissue law is: its functions as one text, for arrays and for kernels alike, and its condition at rest.

A law is written once, as a function `text(math, func)` of a namespace with exp, sqrt, ... and of a decorator: NumPy
with `plain` gives functions of arrays, the kernel language with its `func` gives functions that are inlined into
kernels. Both take the same numbers to the same bits. To add a law: a file beside this one, a line in the table LAWS,
its keys.

Strains e_i = E_i + shift: Green-Lagrange from the pressurised state, shifted by the prestrain; `shift` itself is
handed over for laws that ask for the stretch. c: the law's coefficients.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np


class Functions(NamedTuple):
    """A law's functions of (e1, e2, shift, c).

    energy: W [J per m^3 of reference tissue]; stress: second Piola-Kirchhoff (S1, S2) [Pa]; tangent: (C11, C12, C22,
    C66) [Pa], C_ij = dS_i/dE_j and C66 the tangent of the shear in the plane.
    """

    energy: Callable
    stress: Callable
    tangent: Callable


def plain(function):
    """The decorator of functions that need none."""
    return function


@dataclass(frozen=True)
class Law:
    """A tissue law.

    name; size: number of coefficients; text(math, func): its Functions; coefficients(*constants): those of the text
    from the constants that a scene gives; prestrain(stress, *constants): the shift [1] at which both principal stresses
    are `stress` [Pa] at E = 0, the condition that the wall carries the pressure of the eye at rest.
    """

    name: str
    size: int
    text: Callable[[Any, Callable], Functions]
    coefficients: Callable[..., tuple[float, ...]]
    prestrain: Callable[..., float]

    @cached_property
    def of_arrays(self) -> Functions:
        """The law for numbers and arrays that broadcast."""
        return self.text(np, plain)
