"""Lines between things, and what stands on them: kernels against naive twins, and worlds that change."""

from __future__ import annotations

import numpy as np
import pytest

from mapping.kernels.shapes import highest_pair, near_segment
from scenegraph.perception.relations import Relations
from scenegraph.perception.shapes import Shape
from tests.support.furnishing import Plan, box, cup, placed, plate_on_legs, thing


def naive_near_segment(points: np.ndarray, p: np.ndarray, q: np.ndarray, beside: float, clear: float) -> bool:
    length = np.linalg.norm(q - p)
    if length <= 2 * clear:
        return False
    along = (points - p) @ (q - p) / length
    off = np.linalg.norm(points - p - along[:, None] * (q - p) / length, axis=1)
    return bool(((along > clear) & (along < length - clear) & (off <= beside)).any())


@pytest.mark.parametrize("seed", range(20))
def test_kernels_agree_with_their_naive_twins(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(0, 1, (30, 3)), rng.uniform(0, 1, (20, 3))
    for _ in range(10):
        p, q = rng.uniform(0, 1, (2, 3))
        beside, clear = rng.uniform(0, 0.1), rng.uniform(0, 0.3)
        assert near_segment(a, p, q, beside, clear) == naive_near_segment(a, p, q, beside, clear)
    reach = rng.uniform(0.02, 0.4)
    apart = np.linalg.norm(a[:, None] - b, axis=2)
    near = [(k, int(apart[k].argmin())) for k in range(len(a)) if apart[k].min() <= reach]
    i, j = highest_pair(a, b, reach)
    if not near:
        assert (i, j) == (-1, -1)
    else:
        assert (i, j) in near
        assert min(a[i, 2], b[j, 2]) == max(min(a[k, 2], b[m, 2]) for k, m in near)


def measured(relations: Relations, name: str) -> dict[tuple[str, ...], float]:
    return {key[1:]: value for key, value in relations.facts.put.items() if key[0] == name}


def test_what_comes_between_and_goes_again_is_noticed_without_measuring_the_pair_anew() -> None:
    table, jug = thing(*plate_on_legs(1.4, 0.8, 0.75)), thing(box((0.1, 0.1, 0.2)), at=(0.0, 0.0, 0.75))
    shapes = {
        "table_1": table,
        "cup_1": placed(cup(), (-0.2, 0.0, 0.75)),
        "cup_2": placed(cup(), (0.2, 0.0, 0.75)),
    }
    labels = {name: name[:-2] for name in (*shapes, "jug_1")}
    relations = Relations(lambda _: False)

    def look(now: dict[str, Shape], changed: set[str]) -> dict[tuple[str, ...], float]:
        relations.update(now, labels, changed, Plan())
        at_once = Relations(lambda _: False)
        at_once.update(now, labels, set(now), Plan())
        assert relations.facts.put == at_once.facts.put
        return measured(relations, "things_between")

    assert look(shapes, set(shapes)) == {}
    assert look(shapes | {"jug_1": jug}, {"jug_1"}) == {("cup_1", "cup_2"): 1.0}
    aside = thing(box((0.1, 0.1, 0.2)), at=(0.0, 0.3, 0.75))
    assert look(shapes | {"jug_1": aside}, {"jug_1"}) == {}
    assert look(shapes | {"jug_1": jug}, {"jug_1"}) == {("cup_1", "cup_2"): 1.0}
    back = Relations(lambda _: False)
    back.restore(relations.document(), shapes | {"jug_1": jug})
    back.update(shapes, labels, {"jug_1"}, Plan())
    assert measured(back, "things_between") == {}, "also in a world that comes back from disk"
    assert look(shapes, {"jug_1"}) == {}
