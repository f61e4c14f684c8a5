"""Kernels' functions run as the Python that they are written in, by lanes that take turns.

A GPU's block of threads can be had here only as a play: `Plain` gives an object's functions undecorated and its fields
as lists, copied; `in_turns` gives each lane a thread of its own, of which one at a time runs, from one meeting to the
next, in an order drawn anew each time. So what a lane reads in the same phase in which another lane writes it comes out
one way or the other by chance, and lanes that do not come to the same meetings are found out instead of hanging.
"""

import contextlib
import math
import threading
from types import SimpleNamespace

import numpy as np

from taichi_eye.eye import jet
from taichi_eye.eye.laws import LAWS
from taichi_eye.eye.laws.law import plain
from taichi_eye.mfpm import neighbours, operators
from taichi_eye.solver import aqueous, cornea, coupling, globe, motion, survey, team
from taichi_eye.solver.workspace import FEWEST

# a shell that shears and relaxes under a jet that feels the dent, a globe behind that yields late
ALL_OF_A_WALL = (
    "cornea.flexural_modulus_mpa=0.1",
    "cornea.viscoelastic_share=0.3",
    "cornea.shear_modulus_kpa=10",
    "cornea.shear_viscosity_ms=0.1",
    "chamber.compliance_mm3_mmhg=0.2",
    "chamber.globe_law=friedenwald",
    "chamber.globe_delay_ms=0.5",
    "puff.dent_feedback=0.5",
)
MODULES = aqueous, cornea, coupling, globe, motion, survey, team, operators, neighbours


class Vector(list):
    """Numbers with the arithmetic of the language's vectors; a matrix of two columns is indexed by pairs."""

    n = property(len)

    def _each(self, other, of):
        return Vector(map(of, self, other) if isinstance(other, list) else (of(x, other) for x in self))

    def __add__(self, other):
        return self._each(other, lambda a, b: a + b)

    __radd__ = __iadd__ = __add__

    def __sub__(self, other):
        return self._each(other, lambda a, b: a - b)

    __isub__ = __sub__

    def __mul__(self, other):
        return self._each(other, lambda a, b: a * b)

    __rmul__ = __imul__ = __mul__

    def __truediv__(self, other):
        return self._each(other, lambda a, b: a / b)

    def __neg__(self):
        return Vector(-x for x in self)

    def __getitem__(self, key):
        return super().__getitem__(2 * key[0] + key[1] if isinstance(key, tuple) else key)

    def dot(self, other):
        return sum(a * b for a, b in zip(self, other))

    def sum(self):
        return sum(self)

    def norm_sqr(self):
        return self.dot(self)

    def norm(self):
        return math.sqrt(self.norm_sqr())

    def normalized(self):
        return self / self.norm()


LANGUAGE = SimpleNamespace(
    **{name: getattr(math, name) for name in ("sqrt", "exp", "log", "sin", "cos", "tan", "atan2")},
    # a maximum forgets NaN, as in kernels
    max=lambda a, b: b if not a >= b and not math.isnan(b) else a,
    min=min,
    abs=abs,
    static=lambda value: value,
    select=lambda which, yes, no: yes if which else no,
    Vector=Vector,
    Matrix=lambda rows: Vector(x for row in rows for x in row),
    math=SimpleNamespace(inf=math.inf, pi=math.pi, isnan=math.isnan, isinf=math.isinf),
)


class Values:
    """A field's values, nested lists of numbers or vectors."""

    def __init__(self, field):
        values = field.to_numpy()
        self.vectors = hasattr(field, "n")
        self.data = (values.reshape(*field.shape, -1) if self.vectors else values).tolist()

    def _row(self, key):
        *outer, last = key if isinstance(key, tuple) else (key,)
        row = self.data
        for index in outer:
            row = row[index]
        return row, last

    def __getitem__(self, key):
        row, last = self._row(key)
        value = row if last is None else row[last]
        return Vector(value) if self.vectors else value

    def __setitem__(self, key, value):
        row, last = self._row(key)
        row[last] = list(value) if self.vectors else value

    def to_numpy(self):
        return np.array(self.data)


class Plain:
    """An object of the solver with its functions undecorated and its fields as they are now, in lists.

    made: what has been made plain already, by identity, for the objects that it holds; fetch: calls what reads a field,
    on the language's own thread; changed: attributes to have instead.
    """

    def __init__(self, thing, made: dict, fetch, **changed):
        self.__dict__.update(changed, _thing=thing, _made=made, _fetch=fetch)
        made[id(thing)] = self

    def __getattr__(self, name):
        own, shared = vars(self._thing).get(name), getattr(type(self._thing), name, None)
        if hasattr(shared, "__wrapped__"):
            value = shared.__wrapped__.__get__(self)
        elif name in TEXTS:
            value = TEXTS[name]
        elif hasattr(own, "__wrapped__"):
            value = own.__wrapped__
        elif hasattr(own, "to_numpy") or type(own).__module__.startswith("taichi_eye."):
            if id(own) not in self._made:
                self._made[id(own)] = (
                    self._fetch(lambda: Values(own))
                    if hasattr(own, "to_numpy")
                    else Plain(own, self._made, self._fetch)
                )
            value = self._made[id(own)]
        else:
            value = own
        setattr(self, name, value)
        return value


TEXTS = dict(zip(("curvature", "narrowing", "mean_over_ring"), jet.text(LANGUAGE, plain)))
TEXTS["law"] = LAWS["exponential"].text(LANGUAGE, plain)


class PartedWays(Exception):
    """Some lanes came to a meeting and others did not."""


class Turns:
    """Lanes that take turns."""

    def __init__(self, lanes: int, rng):
        self.lanes, self.rng, self.phases = lanes, rng, 0
        self._here = threading.local()
        self._back = threading.Semaphore(0)
        self._go = [threading.Semaphore(0) for _ in range(lanes)]
        self._failed, self._wanted = None, None

    def meet(self, eye):
        self._back.release()
        self._go[self._here.lane].acquire()
        if self._failed:
            raise self._failed

    def fetch(self, call):
        """What a call gives on the main thread, for a lane."""
        if threading.current_thread() is threading.main_thread():
            return call()
        self._wanted = call
        self._back.release()
        self._go[self._here.lane].acquire()
        fetched, self._wanted = self._wanted, None
        return fetched

    def _turn(self, lane) -> None:
        self._go[lane].release()
        self._back.acquire()
        while self._wanted:
            self._wanted = self._wanted()
            self._go[lane].release()
            self._back.acquire()

    def run(self, work) -> None:
        """work(lane) by every lane."""

        def body(lane):
            self._here.lane = lane
            self._go[lane].acquire()
            try:
                work(lane)
            except BaseException as error:
                self._failed = self._failed or error
            going.discard(lane)
            self._back.release()

        going = set(range(self.lanes))
        for lane in range(self.lanes):
            threading.Thread(target=body, args=(lane,), daemon=True).start()
        while going:
            for lane in self.rng.permutation(sorted(going)):
                self._turn(lane)
            self.phases += 1
            if 0 < len(going) < self.lanes:
                # all who wait are told, and leave
                self._failed = self._failed or PartedWays(f"after phase {self.phases} only lanes {sorted(going)} go on")
        if self._failed:
            raise self._failed


@contextlib.contextmanager
def as_python():
    """The solver's text as Python: its modules' language is this one."""
    names = "ti", "image_of", "_flat"
    saved = [(module, name, vars(module)[name]) for module in MODULES for name in names if name in vars(module)]
    try:
        for module, name, value in saved:
            setattr(module, name, LANGUAGE if name == "ti" else value.__wrapped__)
        yield
    finally:
        for module, name, value in saved:
            setattr(module, name, value)


def in_turns(lanes: int, rng, thing, work, eyes: int = FEWEST) -> Plain:
    """Run work(lane, plain thing) by a team of so many lanes, the thing's `team`; gives the plain thing."""
    turns, made = Turns(lanes, rng), {}
    theirs = Plain(team.Team(lanes, eyes), made, turns.fetch, meet=turns.meet)
    made_plain = Plain(thing, made, turns.fetch, team=theirs)
    with as_python():
        turns.run(lambda lane: work(lane, made_plain))
    return made_plain
