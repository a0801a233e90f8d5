"""Slow, obvious twins of what the simulation computes fast."""

from __future__ import annotations

from typing import Any

import numpy as np


def bleed(entities: Any, radius: Any, rank: Any) -> Any:
    """Each pixel goes to the highest-ranked entity above its own that has a pixel within its radius."""
    height, width = entities.shape
    out = entities.copy()
    for v in range(height):
        for u in range(width):
            best = int(rank[entities[v, u]])
            for p in range(height):
                for q in range(width):
                    e = entities[p, q]
                    if e and (p - v) ** 2 + (q - u) ** 2 <= radius[e] ** 2 and rank[e] > best:
                        best, out[v, u] = int(rank[e]), e
    return out


def dropped(depth: Any, pixels: int) -> Any:
    """Pixels beside a depth jump, and those at most `pixels` - 1 steps along rows and columns from them."""
    height, width = depth.shape
    edge = np.zeros(depth.shape, dtype=bool)
    for v in range(height):
        for u in range(width):
            for p, q in ((v + 1, u), (v - 1, u), (v, u + 1), (v, u - 1)):
                if 0 <= p < height and 0 <= q < width:
                    z, other = float(depth[v, u]), float(depth[p, q])
                    edge[v, u] |= abs(z - other) > max(0.03, 0.03 * min(z, other))
    out = np.zeros_like(edge)
    for v in range(height):
        for u in range(width):
            for p in range(height):
                for q in range(width):
                    out[v, u] |= edge[p, q] and abs(p - v) + abs(q - u) <= pixels - 1
    return out
