"""Facts about AIST++ from ``manifests/aistpp.yaml``: names of its files, and the split of a sequence."""

from dancedata.core.resources import manifest
from dancedata.formats.aist_names import SONG, SequenceName, parse_name


def sequence_problem(stem: str) -> str:
    """Return why `stem` is not a sequence name, "" if it is one."""
    return "" if parse_name(stem) else "not named as an AIST++ sequence (gBR_sBM_cAll_d04_mBR2_ch08)"


def music_problem(stem: str) -> str:
    """Return why `stem` is not the name of an audio file, "" if it is: that of a sequence or of a song."""
    named = SONG.fullmatch(stem) or parse_name(stem)
    return "" if named else "named neither as an AIST++ sequence nor as a song (mBR2)"


def crossmodal_split(name: SequenceName) -> str:
    """Return the split of a sequence by the crossmodal rule: "train", "val", "test", or "" for none.

    It agrees with the published lists on all 1,408 names: 980 / 20 / 20, and 388 in no split.
    """
    rule = manifest("aistpp")["crossmodal"]
    choreographies = {rule[f"{split}_choreography"]: split for split in ("val", "test")}
    held_out = choreographies.get(name.choreography, "") if name.situation == rule["situation"] else ""
    if name.music in rule["test_music"]:
        return held_out
    return "" if held_out else "train"
