"""OctoMap's trees as nested nodes, slowly and obviously: the twins of `mapping.kernels.octrees` and `octree_merge`."""

import struct
from dataclasses import dataclass, field

import numpy as np

WHITE = (255, 255, 255)
DEPTH, ORIGIN = 16, 1 << 15
Key = tuple[int, int, int]


@dataclass
class Node:
    value: float
    color: tuple[int, int, int] = WHITE
    children: dict[int, "Node"] = field(default_factory=dict)

    def walk(self):
        """This node and all below, depth first."""
        yield self
        for child in sorted(self.children):
            yield from self.children[child].walk()

    def leaves(self, key: Key = (0, 0, 0), level: int = DEPTH):
        """(key of the lowest voxel, level, leaf) of each leaf."""
        if not self.children:
            yield key, level, self
        for child in sorted(self.children):
            yield from self.children[child].leaves(corner_of(key, child, level), level - 1)


def corner_of(key: Key, child: int, level: int) -> Key:
    half = 1 << level - 1
    return key[0] + half * (child & 1), key[1] + half * (child >> 1 & 1), key[2] + half * (child >> 2)


def child_of(voxel: Key, level: int) -> int:
    """The child of a node at `level` that holds a voxel."""
    return sum((voxel[axis] >> level - 1 & 1) << axis for axis in range(3))


def write_full(root: Node | None, resolution: str, kind: str) -> bytes:
    """The `.ot` file of a tree."""
    nodes = list(root.walk()) if root else []
    content = b"# Octomap OcTree file\n# (feel free to add / change comments, but leave the first line as it is!)\n#\n"
    content += f"id {kind}\nsize {len(nodes)}\nres {resolution}\ndata\n".encode()
    for node in nodes:
        color = bytes(node.color) if kind == "ColorOcTree" else b""
        content += struct.pack("<f", node.value) + color + bytes([sum(1 << child for child in node.children)])
    return content


def write_binary(root: Node | None, resolution: str, kind: str = "OcTree") -> bytes:
    """The `.bt` file of a tree: two bits for each child."""
    content = b"# Octomap OcTree binary file\n"
    content += b"# (feel free to add / change comments, but leave the first line as it is!)\n#\n"
    content += f"id {kind}\nsize {len(list(root.walk())) if root else 0}\nres {resolution}\ndata\n".encode()
    for node in root.walk() if root else []:
        if node.children:
            word = 0
            for child, below in node.children.items():
                word |= (3 if below.children else 2 if below.value >= 0.0 else 1) << 2 * child
            content += struct.pack("<H", word)
    return content


def summarise(node: Node) -> None:
    """Give a node what OctoMap gives to one whose children changed, and prune it where those are alike."""
    below = [node.children[child] for child in sorted(node.children)]
    colors = [child.color for child in below if child.color != WHITE]
    node.value = max(child.value for child in below)
    node.color = tuple(sum(c[axis] for c in colors) // len(colors) for axis in range(3)) if colors else WHITE
    if len(below) == 8 and not any(child.children or child.value != below[0].value for child in below):
        if below[0].color == WHITE:
            node.color = WHITE
        node.children = {}


def merge(file, leaf, voxels, evidence_of, value_of, level=DEPTH):
    """(tree, whether it is the file's) of the voxels {key: evidence} that a map has where the file has a node or leaf.

    evidence_of : what the map makes of a log-odds; value_of : the log-odds that is written for an evidence
    """
    if file is not None and not file.children:
        file, leaf = None, file
    if not voxels:
        return None, file is None and leaf is None
    if level == 0:
        (evidence,) = voxels.values()
        if leaf is not None and evidence_of(leaf.value) == evidence:
            return Node(leaf.value, leaf.color), True
        return Node(value_of(evidence), leaf.color if leaf else WHITE), False
    parts = {child: {} for child in range(8)}
    for key, evidence in voxels.items():
        parts[child_of(key, level)][key] = evidence
    node, same = Node(0.0), True
    for child, part in parts.items():
        below = file.children.get(child) if file else None
        made, kept = merge(below, leaf, part, evidence_of, value_of, level - 1)
        same = same and kept
        if made is not None:
            node.children[child] = made
    if not same:
        summarise(node)
    elif file is not None:
        node.value, node.color = file.value, file.color
    else:
        node = Node(leaf.value, leaf.color)
    return node, same


def voxels_of(root: Node | None, evidence_of) -> dict[Key, int]:
    """{key: evidence} of all voxels below the leaves."""
    voxels = {}
    for key, level, leaf in root.leaves() if root else []:
        for i, j, k in np.ndindex(*(1 << level,) * 3):
            voxels[key[0] + i, key[1] + j, key[2] + k] = evidence_of(leaf.value)
    return voxels


def random_tree(rng: np.random.Generator, values: list[float], colored: bool, level: int = DEPTH) -> Node:
    """A tree that OctoMap could have, pruned or not, with whatever in its nodes with children."""
    color = tuple(int(c) for c in rng.choice([0, 7, 255], 3)) if colored and rng.random() < 0.7 else WHITE
    node = Node(float(rng.choice(values)), color)
    if level > 4:  # one way down, so that trees stay small
        children = rng.choice(8, 1 + (rng.random() < 0.05), replace=False)
    elif level == 0 or rng.random() < (0.0, 0.6, 0.6, 0.4, 0.1)[level]:
        return node
    else:
        children = np.flatnonzero(rng.random(8) < rng.choice([0.2, 0.4, 0.7] if level > 2 else [0.2, 1.0]))
    for child in children:
        node.children[int(child)] = random_tree(rng, values, colored, level - 1)
    return node
