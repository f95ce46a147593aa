"""Frames: which vehicles a transform tree tells of, and states in one frame through it."""

from __future__ import annotations

import numpy as np

from istc_replay.ingest.batches import distinct
from istc_replay.ingest.columns import Block, Ints
from istc_replay.ingest.meaning import GENERIC_FRAMES, Floats, Names
from istc_replay.ingest.problems import Problems, quoted

#: Transforms from one frame to the root of its tree.
_LONGEST_CHAIN = 32
#: The Earth's frame is no plane: a tree is followed up to the frame below it.
_EARTH = "earth"


class TransformTree:
    """The planar transforms of a log: where each child frame stands in its parent, over time."""

    def __init__(self, blocks: list[Block], names: Names) -> None:
        self._names = names
        self._edges: dict[int, tuple[int, Ints, Floats]] = {}
        if not blocks:
            return
        child = np.concatenate([block.whole["child"] for block in blocks])
        parent = np.concatenate([block.whole["frame"] for block in blocks])
        time_ns = np.concatenate([block.whole["time_ns"] for block in blocks])
        pose = np.stack([np.concatenate([b.numbers[name] for b in blocks]) for name in _POSE], axis=1)
        sound = np.isfinite(pose).all(axis=1) & (child >= 0) & (parent >= 0)
        order = np.lexsort((time_ns, child))
        order = order[sound[order]]
        child, parent, time_ns, pose = child[order], parent[order], time_ns[order], pose[order]
        bounds = np.flatnonzero(np.diff(child, prepend=-2, append=-2))
        for start, end in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
            parents, counts = np.unique(parent[start:end], return_counts=True)
            main = parents[counts.argmax()]
            own = np.arange(start, end)[parent[start:end] == main]
            turned = pose[own].copy()
            turned[:, 2] = np.unwrap(turned[:, 2])
            self._edges[int(child[start])] = (int(main), time_ns[own], turned)

    def vehicles(self) -> set[int]:
        """Tell the frames that are vehicles: those named like base_link, else those with no frame in them."""
        texts = self._names.texts
        named = {c for c in self._edges if texts[c].strip("/").rpartition("/")[2] in GENERIC_FRAMES}
        parents = {edge[0] for edge in self._edges.values()}
        return named or {child for child in self._edges if child not in parents}

    def chain(self, frame: int) -> list[int]:
        """Child frames from a frame up to the root of its tree."""
        chain: list[int] = []
        while frame in self._edges and frame not in chain and len(chain) < _LONGEST_CHAIN:
            if self._names.texts[self._edges[frame][0]].strip("/") == _EARTH:
                break
            chain.append(frame)
            frame = self._edges[frame][0]
        return chain

    def root(self, frame: int) -> int:
        """Return the root of a frame's tree."""
        chain = self.chain(frame)
        return self._edges[chain[-1]][0] if chain else frame

    def poses(self, frame: int, time_ns: Ints) -> Floats:
        """Pose (n, 3) of a child frame in its parent at times, linear in between, held beyond the ends."""
        _, times, pose = self._edges[frame]
        at = (time_ns - times[0]).astype(np.float64)
        known = (times - times[0]).astype(np.float64)
        return np.stack([np.interp(at, known, pose[:, k]) for k in range(3)], axis=1)


_POSE = ("x_m", "y_m", "heading_rad")


def to_root(block: Block, tree: TransformTree) -> None:
    """Move a block's poses from their frames into the roots of their trees, in place."""
    frames = block.whole["frame"]
    for frame in distinct(frames)[0].tolist():
        chain = tree.chain(frame) if frame >= 0 else []
        if not chain:
            continue
        rows = np.flatnonzero(frames == frame)
        for name in _POSE:
            if name in block.numbers:  # which may be a view of what was decoded
                block.numbers[name] = block.numbers[name].copy()
        for child in chain:
            pose = tree.poses(child, block.whole["time_ns"][rows])
            along, across = np.cos(pose[:, 2]), np.sin(pose[:, 2])
            x, y = block.numbers["x_m"][rows], block.numbers["y_m"][rows]
            block.numbers["x_m"][rows] = pose[:, 0] + along * x - across * y
            block.numbers["y_m"][rows] = pose[:, 1] + across * x + along * y
            if "heading_rad" in block.numbers:
                block.numbers["heading_rad"][rows] += pose[:, 2]
        frames[rows] = tree.root(frame)


def check_frames(blocks: list[Block], names: Names, problems: Problems) -> None:
    """Tell where states stand in several frames that no transforms join."""
    found = {code for block in blocks for code in distinct(block.whole["frame"])[0].tolist() if code >= 0}
    if len(found) > 1:
        told = sorted(names.texts[code] for code in found)
        listed = ", ".join(quoted(frame) for frame in told[:5])
        detail = (
            f"states are told in {len(told)} frames with no transforms between them, taken for one: {listed}"
        )
        problems.add("frames_differ", detail)
