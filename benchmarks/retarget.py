"""Residuals and sliding of feet when captures are retargeted to smpl24: python benchmarks/retarget.py FILE.bvh ...

Sliding is the horizontal path of the toes in the contacts of the source, cm per step between two frames; that of the
source is scaled as the world is.
"""

import argparse
from pathlib import Path

import numpy as np

from dancedata.core.skeleton import SMPL24
from dancedata.datasets.folder.facts import Declared
from dancedata.datasets.folder.load import Reading, load_motion
from dancedata.retarget.feet import contact_spans, sliding
from dancedata.retarget.transfer import retargeted


def main() -> None:
    """Print one row of a table for each file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--unit", default="guess")
    parser.add_argument("--up")
    options = parser.parse_args()
    print("| capture | frames | scale | residual, cm: median, largest | at | steps in contact |", end="")
    print(" sliding: source | copied | feet kept |\n|---|---|---|---|---|---|---|---|---|")
    for path in options.files:
        motion = load_motion(path, Reading(Declared(), Declared(unit=options.unit, up=options.up)))
        kept, copied = (retargeted(motion, SMPL24, feet=feet) for feet in (True, False))
        feet = motion.joints()[:, 10:12]
        spans = [contact_spans(feet[:, side], float(motion.grid.rate)) for side in (0, 1)]
        slid = []
        for toes in (feet * kept.scale, copied.motion.joints()[:, 10:12], kept.motion.joints()[:, 10:12]):
            paths = [sliding(toes[:, side], spans[side]) for side in (0, 1)]
            steps = sum(n for _, n in paths)
            slid.append(f"{100 * sum(path for path, _ in paths) / max(steps, 1):.3f}")
        cells = " | ".join(slid)
        worst = int(kept.residual_m.argmax())
        print(
            f"| {path.stem} | {motion.n_frames} | {kept.scale:.3f} | {100 * np.median(kept.residual_m):.1f}, "
            f"{100 * kept.residual_m[worst]:.1f} | {SMPL24.joints[kept.joint[worst]]} | {steps} | {cells} |"
        )


if __name__ == "__main__":
    main()
