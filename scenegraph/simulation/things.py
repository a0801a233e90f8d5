"""Small things of a home: what stands on furniture, lies in containers or about the floor, each with seeded sizes."""

from __future__ import annotations

from numpy.random import Generator

from scenegraph.simulation.furniture import pick
from scenegraph.simulation.shapes import Color, Model, Shape

_BRIGHT: tuple[Color, ...] = (
    (200, 60, 50),
    (50, 110, 190),
    (230, 180, 50),
    (70, 150, 90),
    (150, 80, 160),
    (235, 235, 230),
)
_METAL: Color = (160, 165, 170)
_BLACK: Color = (35, 35, 38)


def cup(rng: Generator) -> Model:
    """A hollow cup with a handle."""
    r, h = rng.uniform(0.038, 0.045), rng.uniform(0.085, 0.105)
    shape = Shape("cup", pick(rng, _BRIGHT))
    shape.revolve([(0, 0), (r * 0.85, 0), (r, h), (r - 0.006, h), (r * 0.8 - 0.006, 0.01), (0, 0.01)])
    return shape.box((r, r + 0.025), (-0.006, 0.006), (h * 0.25, h * 0.75)).model()


def plate(rng: Generator) -> Model:
    """A flat, round plate with a raised rim."""
    r = rng.uniform(0.11, 0.13)
    shape = Shape("plate", pick(rng, ((235, 235, 230), (190, 200, 215))))
    profile = [(0, 0), (r * 0.6, 0), (r, 0.026), (r - 0.005, 0.028), (r * 0.6, 0.01), (0, 0.01)]
    return (
        shape.revolve(profile, sides=20).surface((-r * 0.42, r * 0.42), (-r * 0.42, r * 0.42), 0.01, 0.4, 0.0).model()
    )


def bowl(rng: Generator) -> Model:
    """A hollow bowl, wide enough for fruit."""
    r, h = rng.uniform(0.14, 0.16), rng.uniform(0.09, 0.11)
    shape = Shape("bowl", pick(rng, _BRIGHT))
    shape.revolve([(0, 0), (r * 0.8, 0), (r, h), (r - 0.008, h), (r * 0.8 - 0.008, 0.012), (0, 0.012)], sides=20)
    inner = r * 0.54
    return shape.surface((-inner, inner), (-inner, inner), 0.012, 0.4, 0.0).model()


def apple(rng: Generator) -> Model:
    """An apple."""
    return Shape("apple", pick(rng, ((190, 50, 45), (120, 170, 60)))).ball(rng.uniform(0.037, 0.042)).model()


def orange(rng: Generator) -> Model:
    """An orange."""
    return Shape("orange", (240, 140, 30)).ball(rng.uniform(0.038, 0.044)).model()


def bottle(rng: Generator) -> Model:
    """A bottle with a neck."""
    r, h = rng.uniform(0.035, 0.045), rng.uniform(0.24, 0.31)
    shape = Shape("bottle", pick(rng, ((40, 90, 50), (120, 70, 40), (80, 140, 190), (200, 60, 60))))
    profile = [(0, 0), (r, 0), (r, h * 0.65), (r * 0.4, h * 0.8), (r * 0.4, h), (0, h)]
    return shape.revolve(profile).model()


def kettle(rng: Generator) -> Model:
    """A kettle with a handle."""
    r, h = rng.uniform(0.08, 0.095), rng.uniform(0.2, 0.23)
    shape = Shape("kettle", pick(rng, (_METAL, (180, 50, 50), _BLACK)))
    shape.revolve([(0, 0), (r, 0), (r * 0.75, h), (0, h)])
    shape.box((r * 0.7, r + 0.05), (-0.012, 0.012), (h * 0.85, h * 0.97), _BLACK)
    return shape.box((r + 0.03, r + 0.05), (-0.012, 0.012), (h * 0.3, h * 0.85), _BLACK).model()


def pot(rng: Generator) -> Model:
    """A hollow cooking pot with two handles."""
    r, h = rng.uniform(0.1, 0.12), rng.uniform(0.12, 0.15)
    shape = Shape("pot", pick(rng, (_METAL, (150, 45, 40), (60, 70, 110))))
    shape.revolve([(0, 0), (r, 0), (r, h), (r - 0.008, h), (r - 0.008, 0.01), (0, 0.01)])
    for side in (-1, 1):
        x = sorted((side * r, side * (r + 0.04)))
        shape.box((x[0], x[1]), (-0.03, 0.03), (h * 0.7, h * 0.8), _BLACK)
    return shape.model()


def toaster(rng: Generator) -> Model:
    """A toaster with two slots."""
    w, h = rng.uniform(0.26, 0.3), rng.uniform(0.18, 0.2)
    shape = Shape("toaster", pick(rng, (_METAL, *_BRIGHT)))
    shape.box((-w / 2, w / 2), (-0.08, 0.08), (0.01, h)).box((-w / 2 + 0.02, w / 2 - 0.02), (-0.07, 0.07), (0, 0.01))
    return shape.box((w / 2, w / 2 + 0.02), (-0.02, 0.02), (h * 0.5, h * 0.6), _BLACK).model()


def microwave(rng: Generator) -> Model:
    """A microwave oven with window and handle."""
    w, d, h = rng.uniform(0.46, 0.5), rng.uniform(0.34, 0.38), rng.uniform(0.27, 0.3)
    shape = Shape("microwave", pick(rng, (_METAL, (230, 230, 230))))
    shape.box((-w / 2, w / 2), (-d / 2, d / 2), (0, h))
    shape.box((-w / 2 + 0.02, w / 2 - 0.12), (-d / 2 - 0.01, -d / 2), (0.03, h - 0.03), _BLACK)
    return shape.model()


def vessel_sink(rng: Generator) -> Model:
    """A hollow sink that sits on a counter, with a tap."""
    w, d, h = rng.uniform(0.44, 0.5), rng.uniform(0.36, 0.4), rng.uniform(0.13, 0.15)
    shape = Shape("sink", _METAL)
    shape.open_box((-w / 2, w / 2), (-d / 2, d / 2), (0, h), 0.025)
    return shape.box((-0.015, 0.015), (d / 2 - 0.025, d / 2), (h, h + 0.18)).model()


def tv(rng: Generator) -> Model:
    """A television on a foot."""
    w, h = rng.uniform(0.95, 1.2), rng.uniform(0.55, 0.68)
    shape = Shape("tv", _BLACK)
    shape.box((-0.2, 0.2), (-0.1, 0.1), (0, 0.02)).box((-0.04, 0.04), (0.0, 0.03), (0.02, 0.08))
    return shape.box((-w / 2, w / 2), (-0.025, 0.025), (0.08, 0.08 + h)).model()


def monitor(rng: Generator) -> Model:
    """A computer screen on a foot."""
    w, h = rng.uniform(0.5, 0.6), rng.uniform(0.32, 0.36)
    shape = Shape("monitor", _BLACK)
    shape.box((-0.12, 0.12), (-0.09, 0.09), (0, 0.015)).box((-0.03, 0.03), (0.02, 0.05), (0.015, 0.15))
    return shape.box((-w / 2, w / 2), (-0.02, 0.02), (0.12, 0.12 + h)).model()


def laptop(rng: Generator) -> Model:
    """An open laptop."""
    w, d = rng.uniform(0.31, 0.36), rng.uniform(0.22, 0.25)
    shape = Shape("laptop", pick(rng, (_METAL, (60, 62, 66))))
    shape.box((-w / 2, w / 2), (-d / 2, d / 2), (0, 0.02))
    return shape.box((-w / 2, w / 2), (d / 2 - 0.012, d / 2), (0.02, 0.02 + d), _BLACK, tilt=-0.25).model()


def keyboard(rng: Generator) -> Model:
    """A keyboard."""
    w = rng.uniform(0.4, 0.45)
    shape = Shape("keyboard", pick(rng, (_BLACK, (215, 215, 215))))
    return shape.box((-w / 2, w / 2), (-0.07, 0.07), (0, 0.02)).box((-w / 2, w / 2), (0.0, 0.07), (0.02, 0.035)).model()


def printer(rng: Generator) -> Model:
    """A printer with a paper tray."""
    w, d, h = rng.uniform(0.42, 0.46), rng.uniform(0.32, 0.36), rng.uniform(0.2, 0.25)
    shape = Shape("printer", pick(rng, ((225, 225, 225), _BLACK)))
    shape.box((-w / 2, w / 2), (-d / 2, d / 2), (0, h))
    return shape.box((-w * 0.35, w * 0.35), (-d / 2 - 0.08, -d / 2), (0.05, 0.07)).model()


def book(rng: Generator) -> Model:
    """A book that lies flat."""
    w, d, h = rng.uniform(0.15, 0.21), rng.uniform(0.22, 0.28), rng.uniform(0.03, 0.05)
    shape = Shape("book", pick(rng, _BRIGHT))
    shape.box((-w / 2, w / 2), (-d / 2, d / 2), (0, h))
    return shape.surface((-w / 2, w / 2), (-d / 2, d / 2), h, 0.3, 0.0).model()


def standing_book(rng: Generator) -> Model:
    """A thick book that stands on its lower edge."""
    w, d, h = rng.uniform(0.04, 0.07), rng.uniform(0.16, 0.2), rng.uniform(0.22, 0.29)
    return Shape("book", pick(rng, _BRIGHT)).box((-w / 2, w / 2), (-d / 2, d / 2), (0, h)).model()


def vase(rng: Generator) -> Model:
    """A hollow vase with a belly."""
    r, h = rng.uniform(0.07, 0.09), rng.uniform(0.22, 0.3)
    shape = Shape("vase", pick(rng, _BRIGHT))
    outside = [(0, 0), (r * 0.6, 0), (r, h * 0.4), (r * 0.5, h * 0.8), (r * 0.6, h)]
    inside = [(r * 0.6 - 0.01, h), (r * 0.5 - 0.01, h * 0.8), (r * 0.5 - 0.01, h * 0.3), (0, h * 0.3)]
    return shape.revolve(outside + inside).model()


def table_lamp(rng: Generator) -> Model:
    """A lamp for a table."""
    h = rng.uniform(0.36, 0.46)
    shape = Shape("lamp", pick(rng, _BRIGHT))
    shape.cylinder(0.07, (0, 0.025)).cylinder(0.02, (0.025, h - 0.16), sides=8)
    return shape.revolve([(0, h - 0.18), (0.12, h - 0.18), (0.075, h), (0, h)], color=(240, 225, 180)).model()


def alarm_clock(rng: Generator) -> Model:
    """An alarm clock."""
    w, h = rng.uniform(0.12, 0.15), rng.uniform(0.08, 0.1)
    shape = Shape("clock", pick(rng, _BRIGHT))
    shape.box((-w / 2, w / 2), (-0.035, 0.035), (0, h))
    return shape.box((-w / 2 + 0.01, w / 2 - 0.01), (-0.04, -0.035), (0.01, h - 0.01), _BLACK).model()


def pillow(rng: Generator) -> Model:
    """A bed pillow."""
    return _cushion(rng, "pillow", rng.uniform(0.5, 0.6), rng.uniform(0.34, 0.4), 0.12, (238, 238, 240))


def cushion(rng: Generator) -> Model:
    """A sofa cushion that lies flat."""
    w = rng.uniform(0.34, 0.4)
    return _cushion(rng, "cushion", w, w, 0.12, pick(rng, _BRIGHT))


def _cushion(rng: Generator, label: str, w: float, d: float, h: float, color: Color) -> Model:
    shape = Shape(label, color)
    shape.box((-w / 2 + 0.03, w / 2 - 0.03), (-d / 2 + 0.03, d / 2 - 0.03), (0, h * 0.3))
    shape.box((-w / 2, w / 2), (-d / 2, d / 2), (h * 0.3, h * 0.7))
    return shape.box((-w / 2 + 0.03, w / 2 - 0.03), (-d / 2 + 0.03, d / 2 - 0.03), (h * 0.7, h)).model()


def towel(rng: Generator) -> Model:
    """A folded towel."""
    w, d, h = rng.uniform(0.26, 0.32), rng.uniform(0.2, 0.24), rng.uniform(0.07, 0.1)
    shape = Shape("towel", pick(rng, _BRIGHT))
    return shape.box((-w / 2, w / 2), (-d / 2, d / 2), (0, h)).model()


def trash_bin(rng: Generator) -> Model:
    """A hollow, round bin."""
    r, h = rng.uniform(0.13, 0.16), rng.uniform(0.3, 0.4)
    shape = Shape("bin", pick(rng, (_METAL, _BLACK, *_BRIGHT)))
    return shape.revolve([(0, 0), (r * 0.85, 0), (r, h), (r - 0.01, h), (r * 0.85 - 0.01, 0.015), (0, 0.015)]).model()


def basket(rng: Generator) -> Model:
    """A low, wide basket, open at the top."""
    w, d, h = rng.uniform(0.46, 0.54), rng.uniform(0.38, 0.44), rng.uniform(0.2, 0.26)
    shape = Shape("basket", pick(rng, ((190, 150, 100), (160, 120, 80))))
    shape.open_box((-w / 2, w / 2), (-d / 2, d / 2), (0, h), 0.02)
    return shape.surface((-w / 2 + 0.02, w / 2 - 0.02), (-d / 2 + 0.02, d / 2 - 0.02), 0.02, 0.5, 0.02).model()


def box(rng: Generator) -> Model:
    """An open cardboard box."""
    w, d, h = rng.uniform(0.3, 0.36), rng.uniform(0.24, 0.28), rng.uniform(0.17, 0.22)
    shape = Shape("box", (185, 145, 95))
    shape.open_box((-w / 2, w / 2), (-d / 2, d / 2), (0, h), 0.012)
    return shape.surface((-w / 2 + 0.012, w / 2 - 0.012), (-d / 2 + 0.012, d / 2 - 0.012), 0.012, 0.4, 0.015).model()


def toy_ball(rng: Generator) -> Model:
    """A toy ball."""
    return Shape("ball", pick(rng, _BRIGHT)).ball(rng.uniform(0.07, 0.1)).model()


def toy_block(rng: Generator) -> Model:
    """A wooden toy block."""
    w = rng.uniform(0.08, 0.1)
    return Shape("toy_block", pick(rng, _BRIGHT)).box((-w / 2, w / 2), (-w / 2, w / 2), (0, w)).model()


def teddy(rng: Generator) -> Model:
    """A teddy bear, sitting: body, head, arms and legs."""
    shape = Shape("teddy_bear", pick(rng, ((160, 110, 60), (200, 170, 120))))
    shape.ball(0.09, 0.0, (0.0, 0.03)).ball(0.07, 0.15, (0.0, 0.02))
    for side in (-1, 1):
        shape.ball(0.04, 0.0, (side * 0.07, -0.08)).ball(0.03, 0.1, (side * 0.1, 0.0))
    return shape.model()


def shoe(rng: Generator) -> Model:
    """A shoe."""
    length, color = rng.uniform(0.26, 0.3), pick(rng, (_BLACK, (110, 70, 40), *_BRIGHT))
    shape = Shape("shoe", color)
    shape.box((-0.05, 0.05), (-length / 2, length / 2), (0, 0.05))
    return shape.box((-0.045, 0.045), (0.0, length / 2), (0.05, 0.11)).model()


def backpack(rng: Generator) -> Model:
    """A backpack with a front pocket."""
    w, h = rng.uniform(0.28, 0.32), rng.uniform(0.4, 0.46)
    shape = Shape("backpack", pick(rng, _BRIGHT))
    shape.box((-w / 2, w / 2), (-0.08, 0.08), (0, h))
    return shape.box((-w / 2 + 0.04, w / 2 - 0.04), (-0.14, -0.08), (0.03, h * 0.5)).model()


def speaker(rng: Generator) -> Model:
    """A loudspeaker box."""
    h = rng.uniform(0.24, 0.3)
    shape = Shape("speaker", _BLACK)
    shape.box((-0.08, 0.08), (-0.09, 0.09), (0, h))
    return shape.box((-0.06, 0.06), (-0.1, -0.09), (0.03, h - 0.03), (70, 70, 75)).model()


def small_plant(rng: Generator) -> Model:
    """A potted plant for a table or board."""
    shape = Shape("plant", (70, 140, 70))
    shape.revolve([(0, 0), (0.05, 0), (0.065, 0.1), (0, 0.1)], color=(165, 95, 65))
    return shape.revolve([(0, 0.1), (0.03, 0.1), (0.09, 0.16), (0.05, 0.26), (0, 0.26)], sides=9).model()
