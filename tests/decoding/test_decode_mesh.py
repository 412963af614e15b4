"""decode to glb and obj: with a body model and without, of batches and groups, and what is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.core.bodies import SMPLX55
from dancedata.core.errors import UsageError
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.skeleton import SMPL24
from dancedata.formats.body_mesh import BodyMesh
from dancedata.testing.examples import contact_rule_of, random_motion
from tests.body_models import body_model, body_model_arrays
from tests.commands import as_json, run
from tests.formats.test_body_mesh import Read, smplx_vertices
from tests.messages import raises_message

N = 8


def columns(name: str, later: int = 0) -> Any:
    made = REPRESENTATIONS.get(name)()
    return made.encode(random_motion(made.skeleton, N + later).part(later, N + later), contact_rule_of(made))


def vertices_of(path: Path) -> Any:
    return np.array([line.split()[1:] for line in path.read_text().splitlines() if line.startswith("v ")], float)


def test_obj_is_smplx_with_correctives(tmp_path: Path) -> None:
    rows = columns("edge151")
    np.savez(tmp_path / "x.npz", columns=rows)
    options: dict[str, Any] = {"to": "obj", "fps": 30, "body_model": body_model(tmp_path / "SMPL_MALE.npz", SMPL24)}
    files = dancedata.decode(tmp_path / "x.npz", "edge151", out=tmp_path / "out", betas=[1.0, -2.0], **options)
    assert [str(file.relative_to(tmp_path / "out")) for file in files] == [f"x/x_{k:06d}.obj" for k in range(N)]
    motion = BodyMesh.read(options["body_model"], [1.0, -2.0]).on(dancedata.decode(rows, "edge151", fps=30))
    wanted = smplx_vertices(body_model_arrays(SMPL24), motion, np.pad([1.0, -2.0], (0, 8)))
    for file, vertices in zip(files, wanted, strict=True):
        np.testing.assert_allclose(vertices_of(file), vertices, rtol=0, atol=3e-6)
    for frames, numbers in {"3": [3], "2:5": [2, 3, 4], "::4": [0, 4], "6:": [6, 7]}.items():
        out = tmp_path / frames.replace(":", "-")
        some = dancedata.decode(tmp_path / "x.npz", "edge151", out=out, frames=frames, **options)
        assert [file.name for file in some] == [f"x_{k:06d}.obj" for k in numbers]
    for frames in ("8", "5:5", "last", "-1", "0:8:0", ""):
        with raises_message(UsageError, "no such frames", where="a motion of 8 frames"):
            dancedata.decode(tmp_path / "x.npz", "edge151", out=tmp_path / "no", frames=frames, **options)
    assert not (tmp_path / "no").exists()


def test_a_batch_as_glb(tmp_path: Path) -> None:
    np.save(tmp_path / "x.npy", np.stack([columns("lodge319"), columns("lodge319", 1)]))
    options: dict[str, Any] = {"to": "glb", "fps": 30}
    model = body_model(tmp_path / "SMPLX_NEUTRAL.npz", SMPLX55)
    files = dancedata.decode(tmp_path / "x.npy", "lodge319", out=tmp_path / "a", body_model=model, **options)
    assert [file.name for file in files] == ["x_000.glb", "x_001.glb"]
    motions = dancedata.decode(np.load(tmp_path / "x.npy"), "lodge319", fps=30)
    for file, motion in zip(files, motions, strict=True):
        read, posed = Read(file.read_bytes()), BodyMesh.read(model).on(motion)
        places = np.stack(list(read.world(5)))[:, :3, 3]
        np.testing.assert_allclose(places, posed.joints()[5], rtol=0, atol=1e-5)
        assert read.array(read.document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]).shape == (648, 3)
    alone = dancedata.decode(tmp_path / "x.npy", "lodge319", out=tmp_path / "b", **options)
    read = Read(alone[0].read_bytes())
    assert "meshes" not in read.document
    assert len(read.nodes) == 1 + motions[0].skeleton.n_joints


def test_dancers_of_a_group_stay_in_one_world(tmp_path: Path) -> None:
    rows = np.stack([columns("edge151", later) for later in range(3)])
    np.savez(tmp_path / "trio.npz", columns=rows, person_mask=np.array([1, 0, 1]), fps=24.0)
    model = body_model(tmp_path / "m.npz", SMPL24)
    files = dancedata.decode(tmp_path / "trio.npz", "edge151", to="glb", out=tmp_path / "a", body_model=model)
    assert [file.name for file in files] == ["trio_p0.glb", "trio_p2.glb"]
    motions = dancedata.decode(rows, "edge151", mask=[1, 0, 1], fps=24)
    for file, motion in zip(files, (motions[0], motions[2]), strict=True):
        read = Read(file.read_bytes())
        assert motion is not None
        np.testing.assert_allclose(next(read.world(3))[:3, 3], motion.joints()[3, 0], rtol=0, atol=1e-6)
        np.testing.assert_allclose(read.clock, np.arange(N) / 24, rtol=1e-6)


def test_options_that_do_not_go_together(tmp_path: Path) -> None:
    np.save(tmp_path / "x.npy", columns("edge151"))
    model = body_model(tmp_path / "m.npz", SMPL24)
    for to, options in (
        ("obj", {}), ("bvh", {"body_model": model}), ("glb", {"betas": [1.0]}),
        ("glb", {"body_model": model, "frames": "3"}), ("obj", {"body_model": tmp_path / "x.npy"}),
    ):  # fmt: skip
        with raises_message(UsageError, "chosen|model"):
            dancedata.decode(tmp_path / "x.npy", "edge151", to=to, fps=30, out=tmp_path / "o", **options)
    assert not (tmp_path / "o").exists()


def test_the_command(tmp_path: Path) -> None:
    np.save(tmp_path / "x.npy", columns("edge151"))
    model = body_model(tmp_path / "m.npz", SMPL24)
    command = [
        "decode", tmp_path / "x.npy", "--field", "edge151", "--fps", "30", "--body-model", model, "--betas", "1,-2",
    ]  # fmt: skip
    found = as_json(*command, "--to", "obj", "--frames", "2:4", "--out", tmp_path / "out")
    assert [Path(file).name for file in found["files"]] == ["x_000002.obj", "x_000003.obj"]
    tall = dancedata.decode(
        tmp_path / "x.npy", "edge151", to="obj", fps=30, out=tmp_path / "py", body_model=model, betas=[1, -2],
        frames="2",
    )  # fmt: skip
    assert tall[0].read_bytes() == Path(found["files"][0]).read_bytes()
    result = run(*command[:-1], "tall", "--to", "glb", "--out", tmp_path / "b", code=2)
    assert "invalid value for --betas; found tall" in result.output


def test_joints_that_the_model_lacks_are_named_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    np.save(tmp_path / "x.npy", np.stack([columns("edge151")] * 2))
    model = body_model(tmp_path / "m.npz", SMPLX55)
    options: dict[str, Any] = {"to": "glb", "fps": 30, "body_model": model}
    assert len(dancedata.decode(tmp_path / "x.npy", "edge151", out=tmp_path / "out", **options)) == 2
    messages = [record.getMessage() for record in caplog.records]
    assert messages == ["the body model has no left_hand, right_hand, which turn in the motion (2 motions)"]
