"""Scenes as JSON data for the page that plays them.

Joints are whole millimetres from an origin, as differences in time, joint by joint; the low bytes of all numbers come
before the high ones, so that gzip finds repetitions: about 70 kB for 30 s of 24 joints. The page undoes this.
"""

import base64
import gzip
import json
from collections.abc import Sequence
from typing import Any, TypeAlias
from urllib.parse import quote

import numpy as np
import numpy.typing as npt

from dancedata.core.rotations import Float64Array
from dancedata.core.text import shown
from dancedata.scene.figure import Figure
from dancedata.scene.group_scene import GroupScene, Pair
from dancedata.scene.limbs import HEAD, rest_ahead
from dancedata.scene.palette import DANCERS
from dancedata.scene.scene_list import MAX_NAME, Flag, Item, Scene, Word

Json: TypeAlias = dict[str, Any]
#: Largest value of a curve of 16 bits.
_TOP = 65535
#: Radians of a step of turns, and the most joints of a skin: a shader has room for 192 vectors.
_TURN, MAX_SKINNED = 1 / 4096, 64


def scene_payload(scene: Scene, *, turns: bool = False) -> Json:
    """Return a scene for the page, with the turns of its joints if asked for."""
    if scene.members:
        return _group_payload(scene, turns)
    clip, item = scene.item.clip, scene.item
    payload: Json = {
        "id": item.id, "clip": clip.id, "start": item.start, "n": item.n_frames, "number": item.number,
        "fps": float(scene.grid.rate), "seconds": scene.seconds, "field": scene.field,
        "split": clip.split, "genre": clip.genre, "music": clip.music, "dancer": clip.dancer, "bpm": clip.tempo_bpm,
        "source": clip.source, "sourceRate": clip.source_rate,
        "trim": float(scene.grid.seconds(max(0, clip.trim_start - item.start))),
        "figure": None if scene.figure is None else figure_payload(scene.figure, turns=turns),
        "beats": _rounded(scene.rhythm.beats), "windows": [list(window) for window in scene.windows],
        "flags": [_flag(flag) for flag in scene.flags],
        "notes": list(scene.notes),
    }  # fmt: skip
    if scene.rhythm.downbeats:
        payload["downbeats"] = list(scene.rhythm.downbeats)
    if scene.words:
        payload["words"] = _words(scene.words)
    if len(scene.offsets):
        payload["offsets"] = [round(1000 * offset) for offset in scene.offsets.tolist()]
    if len(scene.rhythm.onset):
        payload["onset"] = curve(scene.rhythm.onset, scene.rhythm.onset_rate)
    if scene.movement is not None:
        rate = float(scene.movement.grid.rate)
        payload["speed"] = curve(scene.movement.speed, rate, delay=0.5 / rate)
        pairs = zip(_rounded(scene.movement.key_times), _rounded(scene.movement.prominence), strict=True)
        payload["keys"] = [list(pair) for pair in pairs]
    return payload


def _group_payload(scene: Scene, turns: bool) -> Json:
    """Return the scene of a group: as for a clip, with what the dancers share, and one entry for each dancer."""
    dancers, together = [], scene.together
    for member in scene.members:
        payload = scene_payload(member, turns=turns)
        shared = {key: payload[key] for key in payload if key not in _OF_A_DANCER}
        dancers.append({key: payload[key] for key in payload if key in _OF_A_DANCER})
        dancers[-1] |= {"member": member.item.clip.member, "role": member.item.clip.role, "part": member.item.part}
        if member.numbers:
            dancers[-1]["numbers"] = [list(pair) for pair in member.numbers]
        if together is not None:
            dancers[-1]["figure"]["floor"] = round(together.floor, 4)
    names = dict.fromkeys(member.item.clip.dancer for member in scene.members)
    return {
        **shared, "id": scene.item.id, "group": scene.item.name, "source": scene.item.source,
        "dancer": ", ".join(filter(None, names)), "notes": list(scene.notes), "figure": None, "flags": [],
        **({"words": _words(scene.words)} if scene.words else {}),
        "members": dancers, "pairs": [] if together is None else [_pair(pair, together) for pair in together.pairs],
    }  # fmt: skip


#: Entries of the scene of a clip that differ between the dancers of a group.
_OF_A_DANCER = ("clip", "dancer", "source", "figure", "speed", "keys", "flags", "offsets", "words")


def _words(words: Sequence[Word]) -> Json:
    """Return begin, end, text and dancer of the segments, by layer."""
    layers: Json = {}
    for word in words:
        layers.setdefault(word.layer, []).append([round(word.begin, 4), round(word.end, 4), word.text, word.member])
    return layers


def _pair(pair: Pair, together: GroupScene) -> Json:
    rate = float(together.grid.rate)
    return {
        "of": [pair.first, pair.second], "rate": rate, "distance": curve(pair.distance_m, rate),
        "facing": [curve(angles, rate) for angles in pair.facing_deg],
        "contacts": [[*contact[:4], round(1000 * contact.distance_m)] for contact in pair.contacts],
        "collisions": [list(span) for span in pair.collisions],
    }  # fmt: skip


def figure_payload(figure: Figure, *, turns: bool = False) -> Json:
    """Return the joints of a figure, each coordinate within half a millimetre, with their turns if asked for."""
    skeleton = figure.skeleton
    low, high = figure.joints.min(axis=(0, 1)), figure.joints.max(axis=(0, 1))
    origin = np.round((low + high) / 2, 3)
    # 16 bits hold 65 m; a larger extent takes a coarser unit.
    unit = 0.001 * max(1, int(np.ceil(float((high - low).max()) / 65.0)))
    steps = np.round((figure.joints - origin) / unit).astype(np.int64).astype(np.int16)
    limbs, look = figure.limbs, figure.look
    looks = {} if look is None else {"look": packed(np.round(127 * look).astype(np.int8))}
    bits = (figure.contacts * np.array([1, 2, 4, 8], dtype=np.uint8)).sum(axis=1).astype(np.uint8)
    return {
        "frames": figure.n_frames, "rate": float(figure.grid.rate), "unit": unit, "origin": origin.tolist(),
        "joints": list(skeleton.joints), "parents": list(skeleton.parents), "sides": list(figure.sides),
        "pairs": [list(pair) for pair in skeleton.pairs], "feet": list(figure.contact_joints),
        "data": _in_time(steps), "contacts": packed(bits), "stored": figure.contacts_stored,
        "floor": round(figure.floor, 4), "lowest": round(figure.lowest, 4), "tall": round(figure.tall, 4),
        "girths": [[round(radius, 4) for radius in girth] for girth in limbs.girths], "tones": list(limbs.tones),
        "tips": [[*tip[:3], *(round(x, 4) for x in tip[3:])] for tip in limbs.tips], "head": limbs.head,
        "skull": HEAD, **looks, **({"model": True} if figure.mesh else {}),
        **({"turns": turns_payload(figure)} if turns else {}),
    }  # fmt: skip


def turns_payload(figure: Figure) -> Json | None:
    """Return the rest pose of a figure and the turns of its joints, within 0.01 degrees; None for too many joints."""
    if figure.skeleton.n_joints > MAX_SKINNED:
        return None
    # 16 bits hold 2.5 whole turns; axis-angle vectors are continuous where quaternions change their sign.
    length = np.linalg.norm(figure.turns, axis=-1, keepdims=True)
    nearest = figure.turns * (1 - 2 * np.pi * np.round(length / (2 * np.pi)) / np.maximum(length, 1e-9))
    steps = np.round(nearest / _TURN).astype(np.int16)
    return {
        "rest": [round(x, 4) for x in figure.rest.ravel().tolist()], "ahead": _rounded(rest_ahead(figure.skeleton)),
        "unit": _TURN, "data": _in_time(steps),
    }  # fmt: skip


def scene_turns(scene: Scene) -> list[Json | None]:
    """Return the turns of a clip's figure, or of each dancer's."""
    return [None if s.figure is None else turns_payload(s.figure) for s in scene.members or (scene,)]


def _in_time(steps: npt.NDArray[np.int16]) -> str:
    """Return whole numbers (T, ...) as differences in time, column by column, low bytes before high ones."""
    columns = np.ascontiguousarray(np.diff(steps.reshape(len(steps), -1), axis=0, prepend=np.int16(0)).T)
    return packed(np.ascontiguousarray(columns.astype("<i2").view(np.uint8).reshape(-1, 2).T))


def curve(values: Float64Array, rate: float, delay: float = 0.0) -> Json:
    """Return a non-negative curve: 16 bits per value, and the largest value. NaN becomes 0."""
    finite = np.nan_to_num(np.maximum(values, 0.0), nan=0.0, posinf=0.0)
    # Rounded, as the last bit of a sum depends on where numpy's memory begins: equal clips have equal pages.
    top = float(f"{finite.max(initial=0.0):.9g}")
    steps = np.round(finite / (top or 1.0) * _TOP).astype("<u2")
    return {"rate": rate, "delay": delay, "max": top, "data": packed(steps)}


def packed(array: npt.NDArray[Any]) -> str:
    """Return the bytes of an array, compressed, in base64; the same bytes each time."""
    return base64.b64encode(gzip.compress(array.tobytes(), 9, mtime=0)).decode("ascii")


def item_rows(items: tuple[Item, ...], flags: tuple[int, ...]) -> Json:
    """Return the list of items, column by column: about 100 bytes for a clip, 20 for a further window of it."""
    rows: dict[tuple[bool, str], int] = {}
    clips: list[list[Any]] = []
    for item in items:
        if (bool(item.members), item.name) not in rows:
            rows[bool(item.members), item.name] = len(clips)
            clips.append(_item_row(item))
    palette = {"palette": DANCERS} if any(item.members for item in items) else {}
    return {
        "clips": clips,
        "items": [
            [rows[bool(item.members), item.name], item.start, item.n_frames, count]
            for item, count in zip(items, flags, strict=True)
        ],
        "windows": bool(items) and items[0].window is not None, **palette,
    }  # fmt: skip


def _item_row(item: Item) -> list[Any]:
    c = item.clip
    dancers = dict.fromkeys(member.clip.dancer for member in item.members or (item,) if member.clip.dancer)
    names = (shown(text, MAX_NAME) for text in (c.genre, c.music, ", ".join(dancers)))
    row = [item.name, c.split, *names, item.source]
    members = [[m.clip.id, m.clip.member, shown(m.clip.role, MAX_NAME)] for m in item.members]
    return [*row, members] if members else row


def link(
    item: Item, *, at: float = 0.0, loop: tuple[int, int] | None = None, field: str = "", compared: str = "",
    mirrored: bool = False, overlay: bool = False,
) -> str:  # fmt: skip
    """Return the fragment of the page's address that shows an item at a time; a dancer is shown without the group."""
    parts = [f"{'group' if item.members else 'clip'}={quote(item.name, safe='')}"]
    parts += [f"window={item.start}"] if item.window is not None else []
    parts += [f"t={at:.3f}"] if at else []
    parts += [f"loop={loop[0]}-{loop[1]}"] if loop else []
    parts += [f"field={quote(field, safe='')}"] if field else []
    parts += [f"with={quote(compared, safe='')}"] if compared else []
    parts += [name + "=1" for name, on in (("mirror", mirrored), ("over", overlay)) if on]
    return "#" + "&".join(parts)


def page_json(document: Json) -> str:
    """Return JSON that can stand in a script element of a page: no text in it ends the element or opens another."""
    text = json.dumps(document, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _flag(flag: Flag) -> list[Any]:
    return [None if flag.time is None else round(flag.time, 5), flag.kind, flag.joint, flag.value, flag.unit]


def _rounded(values: Float64Array) -> list[float]:
    return [round(float(value), 5) for value in values]
