"""Large things of a home: what stands on the floor or hangs on a wall, each with seeded sizes and colours."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from scenegraph.simulation.shapes import Color, Model, Shape

_WOODS: tuple[Color, ...] = ((156, 112, 70), (120, 80, 50), (190, 150, 105), (95, 65, 45), (205, 175, 135))
_FABRICS: tuple[Color, ...] = ((90, 105, 130), (130, 60, 60), (80, 110, 85), (150, 140, 125), (70, 70, 80))
_WHITE: Color = (235, 235, 232)
_METAL: Color = (150, 155, 160)
_BLACK: Color = (35, 35, 38)


def pick(rng: Generator, colors: tuple[Color, ...]) -> Color:
    """One of `colors`, each channel varied a little."""
    base = np.array(colors[int(rng.integers(len(colors)))])
    r, g, b = np.clip(base + rng.integers(-12, 13, 3), 0, 255).tolist()
    return r, g, b


def _legs(shape: Shape, w: float, d: float, height: float, thick: float, inset: float, color: Color) -> None:
    for sx in (-1, 1):
        for sy in (-1, 1):
            x, y = sx * (w / 2 - inset - thick / 2), sy * (d / 2 - inset - thick / 2)
            shape.box((x - thick / 2, x + thick / 2), (y - thick / 2, y + thick / 2), (0.0, height), color)


def _table(rng: Generator, label: str, w: float, d: float, h: float, thick: float = 0.035, leg: float = 0.06) -> Model:
    wood = pick(rng, _WOODS)
    shape = Shape(label, wood)
    _legs(shape, w, d, h - thick, leg, 0.03, wood)
    shape.box((-w / 2, w / 2), (-d / 2, d / 2), (h - thick, h))
    return shape.surface((-w / 2, w / 2), (-d / 2, d / 2), h).model()


def table(rng: Generator) -> Model:
    """A dining table on four legs."""
    return _table(rng, "table", rng.uniform(1.2, 1.5), rng.uniform(0.78, 0.9), rng.uniform(0.72, 0.76))


def desk(rng: Generator) -> Model:
    """A writing desk on four legs."""
    return _table(rng, "desk", rng.uniform(1.3, 1.6), rng.uniform(0.65, 0.75), rng.uniform(0.72, 0.75))


def coffee_table(rng: Generator) -> Model:
    """A low table on four legs."""
    return _table(rng, "coffee_table", rng.uniform(0.8, 1.0), rng.uniform(0.5, 0.6), rng.uniform(0.4, 0.46))


def stool(rng: Generator) -> Model:
    """A stool on four legs."""
    return _table(rng, "stool", rng.uniform(0.36, 0.42), rng.uniform(0.34, 0.38), rng.uniform(0.42, 0.48), 0.04, 0.045)


def bench(rng: Generator) -> Model:
    """A bench on four legs."""
    return _table(rng, "bench", rng.uniform(0.9, 1.1), rng.uniform(0.32, 0.36), rng.uniform(0.42, 0.46), 0.05, 0.06)


def chair(rng: Generator) -> Model:
    """A chair: four legs, seat and backrest."""
    wood, w, d, seat = pick(rng, _WOODS), rng.uniform(0.42, 0.46), rng.uniform(0.42, 0.46), rng.uniform(0.44, 0.47)
    shape = Shape("chair", wood)
    _legs(shape, w, d, seat - 0.04, 0.045, 0.0, wood)
    shape.box((-w / 2, w / 2), (-d / 2, d / 2), (seat - 0.04, seat))
    shape.box((-w / 2, w / 2), (d / 2 - 0.035, d / 2), (seat, seat + rng.uniform(0.4, 0.48)))
    return shape.surface((-w / 2, w / 2), (-d / 2, d / 2 - 0.04), seat, 0.4, 0.03).model()


def office_chair(rng: Generator) -> Model:
    """A chair on a column with a five-armed foot."""
    fabric, seat = pick(rng, _FABRICS), rng.uniform(0.46, 0.5)
    shape = Shape("office_chair", _BLACK)
    shape.cylinder(0.28, (0.0, 0.05), sides=10).cylinder(0.04, (0.05, seat - 0.08))
    shape.box((-0.25, 0.25), (-0.24, 0.24), (seat - 0.08, seat), fabric)
    shape.box((-0.22, 0.22), (0.2, 0.26), (seat + 0.08, seat + 0.52), fabric)
    shape.box((-0.04, 0.04), (0.2, 0.24), (seat, seat + 0.08))
    return shape.surface((-0.25, 0.25), (-0.24, 0.16), seat, 0.4, 0.04).model()


def sofa(rng: Generator) -> Model:
    """A sofa with back and arms."""
    return _seat(rng, "sofa", rng.uniform(1.7, 2.1))


def armchair(rng: Generator) -> Model:
    """An armchair with back and arms."""
    return _seat(rng, "armchair", rng.uniform(0.82, 0.92))


def _seat(rng: Generator, label: str, w: float) -> Model:
    d, seat = rng.uniform(0.82, 0.9), rng.uniform(0.4, 0.44)
    shape = Shape(label, pick(rng, _FABRICS))
    shape.box((-w / 2, w / 2), (-d / 2, d / 2), (0.0, seat))
    shape.box((-w / 2, w / 2), (d / 2 - 0.2, d / 2), (seat, seat + 0.4))
    for side in (-1, 1):
        x = sorted((side * w / 2, side * (w / 2 - 0.15)))
        shape.box((x[0], x[1]), (-d / 2, d / 2 - 0.2), (seat, seat + 0.18))
    return shape.surface((-w / 2 + 0.15, w / 2 - 0.15), (-d / 2 + 0.1, d / 2 - 0.2), seat, 0.6, 0.02).model()


def bed(rng: Generator) -> Model:
    """A bed: legs, frame, mattress and headboard (at its back)."""
    wood, w, d = pick(rng, _WOODS), rng.uniform(1.4, 1.65), 2.05
    shape = Shape("bed", wood)
    _legs(shape, w, d, 0.2, 0.08, 0.0, wood)
    shape.box((-w / 2, w / 2), (-d / 2, d / 2), (0.2, 0.32))
    shape.box((-w / 2 + 0.03, w / 2 - 0.03), (-d / 2 + 0.03, d / 2 - 0.06), (0.32, 0.5), (225, 222, 215))
    shape.box((-w / 2, w / 2), (d / 2 - 0.05, d / 2), (0.32, 0.95))
    return shape.surface((-w / 2 + 0.03, w / 2 - 0.03), (-d / 2 + 0.1, d / 2 - 0.06), 0.5, 1.5, 0.04).model()


def _cabinet(
    rng: Generator, label: str, w: float, d: float, h: float, color: Color, doors: int = 2, plinth: float = 0.06
) -> Model:
    shape = Shape(label, color)
    shape.box((-w / 2, w / 2), (-d / 2 + 0.02, d / 2), (plinth, h))
    if plinth:
        shape.box((-w / 2, w / 2), (-d / 2 + 0.06, d / 2), (0.0, plinth))
    dark = (int(color[0] * 0.85), int(color[1] * 0.85), int(color[2] * 0.85))
    for k in range(doors):
        x0 = -w / 2 + 0.01 + k * (w - 0.02) / doors
        shape.box((x0, x0 + (w - 0.02) / doors - 0.01), (-d / 2, -d / 2 + 0.02), (plinth + 0.01, h - 0.02), dark)
    return shape.surface((-w / 2, w / 2), (-d / 2 + 0.02, d / 2), h).model()


def wardrobe(rng: Generator) -> Model:
    """A tall closed wardrobe."""
    return _cabinet(rng, "wardrobe", rng.uniform(1.0, 1.4), 0.58, rng.uniform(1.85, 2.0), pick(rng, (*_WOODS, _WHITE)))


def dresser(rng: Generator) -> Model:
    """A chest of drawers."""
    return _cabinet(rng, "dresser", rng.uniform(0.8, 1.0), 0.45, rng.uniform(0.78, 0.9), pick(rng, _WOODS), 1)


def cabinet(rng: Generator) -> Model:
    """A low, shallow cabinet."""
    return _cabinet(rng, "cabinet", rng.uniform(0.7, 0.9), 0.36, rng.uniform(0.8, 0.9), pick(rng, (*_WOODS, _WHITE)))


def wall_cabinet(rng: Generator) -> Model:
    """A kitchen cabinet that hangs on the wall."""
    return _cabinet(rng, "cabinet", rng.uniform(0.8, 1.1), 0.34, rng.uniform(0.55, 0.65), _WHITE, plinth=0.0)


def tv_stand(rng: Generator) -> Model:
    """A low board for a television, with one open compartment."""
    wood, w, d, h = pick(rng, _WOODS), rng.uniform(1.3, 1.6), 0.42, rng.uniform(0.45, 0.52)
    shape = Shape("tv_stand", wood)
    shape.open_box((-w / 2, w / 2), (-d / 2, d / 2), (0.0, h), 0.03, wood, open_front=True)
    return shape.surface((-w / 2, w / 2), (-d / 2, d / 2), h).model()


def nightstand(rng: Generator) -> Model:
    """A bedside table with an open compartment over a drawer."""
    wood, w, d, h = pick(rng, _WOODS), rng.uniform(0.42, 0.48), 0.4, rng.uniform(0.48, 0.55)
    shape = Shape("nightstand", wood)
    shape.box((-w / 2, w / 2), (-d / 2, d / 2), (0.0, 0.2))
    shape.open_box((-w / 2, w / 2), (-d / 2, d / 2), (0.2, h), 0.02, wood, open_front=True)
    return shape.surface((-w / 2, w / 2), (-d / 2, d / 2), h).model()


def shelf(rng: Generator) -> Model:
    """An open shelf: sides, back and boards, things stand on each board."""
    wood, w, d = pick(rng, (*_WOODS, _WHITE)), rng.uniform(0.85, 1.1), rng.uniform(0.32, 0.36)
    boards, step, thick = 4, rng.uniform(0.36, 0.4), 0.025
    h = 0.08 + boards * step + thick
    shape = Shape("shelf", wood)
    for side in (-1, 1):
        x = sorted((side * w / 2, side * (w / 2 - thick)))
        shape.box((x[0], x[1]), (-d / 2, d / 2), (0.0, h))
    inner = (-w / 2 + thick, w / 2 - thick)
    shape.box(inner, (d / 2 - 0.015, d / 2), (0.0, h))
    for k in range(boards + 1):
        z = 0.08 + k * step
        shape.box(inner, (-d / 2, d / 2 - 0.015), (z, z + thick))
        free = step - thick if k < boards else 0.5
        shape.surface(inner, (-d / 2, d / 2 - 0.015), z + thick, free - 0.02)
    return shape.model()


def counter(rng: Generator) -> Model:
    """A kitchen counter with a protruding top."""
    w, h, color = rng.uniform(1.5, 1.9), rng.uniform(0.88, 0.92), pick(rng, (_WHITE, (120, 140, 150), *_WOODS))
    shape = Shape("counter", color)
    shape.box((-w / 2, w / 2), (-0.22, 0.3), (0.0, 0.1), _BLACK)
    shape.box((-w / 2, w / 2), (-0.27, 0.3), (0.1, h - 0.04))
    shape.box((-w / 2, w / 2), (-0.3, 0.3), (h - 0.04, h), (90, 88, 86))
    return shape.surface((-w / 2, w / 2), (-0.3, 0.3), h).model()


def oven(rng: Generator) -> Model:
    """A free-standing cooker: body, glass door, handle, hob."""
    h = rng.uniform(0.86, 0.9)
    shape = Shape("oven", pick(rng, (_METAL, _WHITE)))
    shape.box((-0.3, 0.3), (-0.27, 0.3), (0.0, h - 0.02)).box((-0.3, 0.3), (-0.27, 0.3), (h - 0.02, h), _BLACK)
    shape.box((-0.25, 0.25), (-0.28, -0.27), (0.25, 0.65), _BLACK).box(
        (-0.22, 0.22), (-0.32, -0.28), (0.68, 0.7), _METAL
    )
    return shape.surface((-0.3, 0.3), (-0.27, 0.3), h, 2.0, 0.03).model()


def fridge(rng: Generator) -> Model:
    """A tall refrigerator with two doors and handles."""
    h, color = rng.uniform(1.65, 1.85), pick(rng, (_WHITE, _METAL))
    shape = Shape("fridge", color)
    shape.box((-0.31, 0.31), (-0.28, 0.32), (0.0, h))
    for low, high in ((0.05, 1.1), (1.12, h - 0.02)):
        shape.box((-0.3, 0.3), (-0.31, -0.28), (low, high))
        shape.box((0.24, 0.26), (-0.34, -0.31), (low + 0.15, high - 0.15), _METAL)
    return shape.surface((-0.31, 0.31), (-0.28, 0.32), h, 0.5, 0.03).model()


def washing_machine(rng: Generator) -> Model:
    """A front-loading washing machine."""
    shape = Shape("washing_machine", _WHITE)
    shape.box((-0.3, 0.3), (-0.27, 0.3), (0.0, 0.85))
    shape.box((-0.17, 0.17), (-0.3, -0.27), (0.28, 0.62), (70, 75, 85))
    return shape.surface((-0.3, 0.3), (-0.27, 0.3), 0.85, 1.5, 0.03).model()


def toilet(rng: Generator) -> Model:
    """A toilet: foot, hollow bowl, cistern."""
    shape = Shape("toilet", _WHITE)
    shape.cylinder(0.13, (0.0, 0.22), (0.0, -0.02))
    bowl = [(0.0, 0.2), (0.13, 0.2), (0.2, 0.42), (0.15, 0.42), (0.09, 0.25), (0.0, 0.25)]
    shape.revolve(bowl, (0.0, -0.08), stretch=(0.95, 1.25))
    shape.box((-0.2, 0.2), (0.17, 0.35), (0.38, 0.8))
    shape.box((-0.12, 0.12), (0.05, 0.3), (0.0, 0.38))
    return shape.surface((-0.2, 0.2), (0.17, 0.35), 0.8, 0.6, 0.015).model()


def bathtub(rng: Generator) -> Model:
    """A bathtub, hollow, with a broad rim."""
    w, d, h = rng.uniform(1.5, 1.65), rng.uniform(0.7, 0.75), rng.uniform(0.52, 0.58)
    shape = Shape("bathtub", _WHITE)
    return shape.open_box((-w / 2, w / 2), (-d / 2, d / 2), (0.0, h), 0.07).model()


def washbasin(rng: Generator) -> Model:
    """A sink on a pedestal."""
    h = rng.uniform(0.82, 0.88)
    shape = Shape("sink", _WHITE)
    shape.box((-0.09, 0.09), (-0.05, 0.2), (0.0, h - 0.17))
    shape.open_box((-0.28, 0.28), (-0.22, 0.22), (h - 0.17, h), 0.04)
    return shape.box((-0.015, 0.015), (0.19, 0.215), (h, h + 0.12), _METAL).model()


def floor_lamp(rng: Generator) -> Model:
    """A lamp on a tall pole."""
    h = rng.uniform(1.5, 1.7)
    shape = Shape("lamp", _METAL)
    shape.cylinder(0.14, (0.0, 0.03)).cylinder(0.02, (0.03, h - 0.22), sides=8)
    shade = [(0.0, h - 0.25), (0.2, h - 0.25), (0.13, h), (0.0, h)]
    return shape.revolve(shade, color=(240, 225, 180)).model()


def plant(rng: Generator) -> Model:
    """A plant in a pot: stem and a crown of leaves."""
    r, h = rng.uniform(0.13, 0.17), rng.uniform(0.8, 1.2)
    shape = Shape("plant", (60, 125, 60))
    shape.revolve([(0.0, 0.0), (r * 0.75, 0.0), (r, 0.28), (0.0, 0.28)], color=pick(rng, ((165, 95, 65), _WHITE)))
    shape.cylinder(0.025, (0.28, h - 0.35), color=(100, 80, 50), sides=6)
    crown = rng.uniform(0.2, 0.27)
    profile = [(0.0, h - 0.5), (crown, h - 0.35), (crown * 0.9, h - 0.15), (crown * 0.4, h), (0.0, h)]
    return shape.revolve(profile, sides=9).model()


def mirror(rng: Generator) -> Model:
    """A framed mirror for the wall (it does not reflect)."""
    w, h = rng.uniform(0.5, 0.65), rng.uniform(0.6, 0.75)
    shape = Shape("mirror", (190, 205, 215))
    shape.box((-w / 2 + 0.02, w / 2 - 0.02), (-0.01, 0.015), (0.02, h - 0.02))
    return _frame(shape, w, h, _METAL)


def picture(rng: Generator) -> Model:
    """A framed picture for the wall."""
    w, h = rng.uniform(0.4, 0.8), rng.uniform(0.35, 0.55)
    shape = Shape("picture", pick(rng, ((200, 120, 60), (60, 110, 170), (170, 60, 110))))
    shape.box((-w / 2 + 0.02, w / 2 - 0.02), (-0.005, 0.015), (0.02, h - 0.02))
    return _frame(shape, w, h, pick(rng, _WOODS))


def _frame(shape: Shape, w: float, h: float, color: Color) -> Model:
    for x in ((-w / 2, -w / 2 + 0.03), (w / 2 - 0.03, w / 2)):
        shape.box(x, (-0.02, 0.015), (0.0, h), color)
    for z in ((0.0, 0.03), (h - 0.03, h)):
        shape.box((-w / 2 + 0.03, w / 2 - 0.03), (-0.02, 0.015), z, color)
    return shape.model()
