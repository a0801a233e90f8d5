"""What was seen of a surface is nearest, not what lies hidden behind it."""

import numpy as np

from scenegraph.simulation.seen_surface import CELL_M, SeenSurface


def test_the_nearest_seen_point_tells_the_triangle():
    rng = np.random.default_rng(0)
    surface = SeenSurface()
    points, triangles = rng.uniform(-1.0, 1.0, (3000, 3)), rng.integers(0, 50, 3000)
    for part in np.array_split(np.arange(3000), 70):
        surface.add(points[part], triangles[part])
    asked = rng.uniform(-1.2, 1.2, (400, 3))
    found, distance = surface.closest(asked, 0.1)
    true = np.linalg.norm(asked[:, None] - points[None], axis=2)
    near = true.min(axis=1) < 0.1 - CELL_M
    assert (found[true.min(axis=1) >= 0.1] == -1).all()
    assert np.allclose(distance[near], true.min(axis=1)[near], atol=CELL_M * 3**0.5)
    exact = near & (np.abs(distance - true.min(axis=1)) < 1e-6)
    assert exact.mean() > 0.8 * near.mean()
    assert np.array_equal(found[exact], triangles[true.argmin(axis=1)][exact])


def test_before_anything_was_seen_nothing_is_near():
    found, distance = SeenSurface().closest(np.zeros((2, 3)), 1.0)
    assert found.tolist() == [-1, -1]
    assert np.isinf(distance).all()
