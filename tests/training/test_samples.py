"""Samples in a training: numbers as evaluate has them, pages beside the truth, Lightning and Accelerate."""

import csv
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch")

import torch
from torch.utils.data import DataLoader

import dancedata
from dancedata import Evaluator
from dancedata.core.errors import UsageError
from dancedata.store import Store, open_store
from dancedata.torch import ClipDataset, Scale, WindowDataset, pad_clips
from dancedata.training import SampleLog
from tests.messages import raises_message
from tests.scene.helpers import page_data
from tests.scene.test_scenes import unpacked

FIELDS = ("edge151", "librosa35")
RECIPE: dict[str, Any] = {
    "recipe": 1, "name": "toy", "dataset": {"synthetic": {"songs": 5, "clips_per_song": 2, "clip_s": 7}},
    "windows": {"length_s": 5, "stride_s": 1}, "motion": {"edge151": {}}, "audio": {"librosa35": {}},
}  # fmt: skip


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("built") / "toy"
    dancedata.build(RECIPE, None, out, jobs=1, progress=False)
    return out


@pytest.fixture(scope="module")
def store(path: Path) -> Store:
    return open_store(path)


def evaluator(path: Path) -> Evaluator:
    return Evaluator(path, "edge151", normalized=True)


def windows(path: Path, split: str = "val") -> WindowDataset:
    return WindowDataset(path, split, fields=FIELDS, scale=Scale(fields=("edge151",)))


def test_the_truth_as_samples_has_the_numbers_of_evaluate(path: Path, tmp_path: Path) -> None:
    log = SampleLog(evaluator(path), tmp_path / "walls", wall=3)
    plain = evaluator(path)
    for batch in DataLoader(windows(path), batch_size=4):
        log.update(batch["edge151"], batch)
        plain.update(batch["edge151"], batch["id"], music=batch["librosa35"])
    done = log.finish(40)
    report = plain.compute()
    assert done.report is not None
    numbers = {f"samples/{name}": value for name, value in report.numbers().items()}
    assert done.numbers == pytest.approx({**numbers, "samples/left_out": 0.0}, rel=1e-9)
    assert done.numbers["samples/n_clips"] == report.recordings > 0
    means = {score.name for score in report.scores if score.verdict != "void"}
    assert {name.removeprefix("samples/") for name in done.numbers} == {*means, "n_clips", "left_out"}
    assert "fid_k" not in means  # a distance of so few clips means nothing
    assert done.page == tmp_path / "walls" / "step-00000040.html"
    assert len(log.evaluator) == 0


def placed(joints: np.ndarray) -> np.ndarray:
    """Return joints (T, J, 3) with the first root above 0 and the lowest joint of all at 0."""
    return np.asarray(joints - joints[0, 0] * (1, 0, 1) - (0, joints[..., 1].min(), 0))


def test_a_page_shows_each_sample_beside_its_window(path: Path, store: Store, tmp_path: Path) -> None:
    """The dancer called truth moves as the dataset says, the one called sample as the columns that were given."""
    log = SampleLog(evaluator(path), tmp_path, wall=2)
    batch = next(iter(DataLoader(windows(path), batch_size=4)))
    log.update(batch["edge151"].flip(1), batch)  # danced backwards
    page = page_data(log.finish(3).page or tmp_path)
    assert page["head"]["name"] == "2 samples at step 3"
    assert (page["head"]["clips"], len(page["clips"])) == (2, 2)
    for number, (clip, start) in enumerate(zip(batch["clip"][:2], batch["start"][:2].tolist(), strict=True)):
        payload = page["clips"][str(number)]
        assert (payload["id"], payload["start"], payload["n"]) == (f"{clip}@{start}+150", start, 150)
        assert payload["beats"]
        assert [member["part"] for member in payload["members"]] == ["truth", "sample"]
        rows = store.read(store.windows("val")[number], "edge151")
        for member, columns in zip(payload["members"], (rows, rows[::-1]), strict=True):
            joints = dancedata.decode(columns, "edge151", fps=store.fps).joints()
            # Both are rounded to a millimetre, and the scaler to float32.
            np.testing.assert_allclose(placed(unpacked(member["figure"])), placed(joints), rtol=0, atol=2e-3)
    numbers = dict(page["clips"]["0"]["members"][1]["numbers"])
    assert {"BAS", "sliding", "PFC", "distance"} == set(numbers)


def test_whole_clips_that_are_padded(path: Path, tmp_path: Path) -> None:
    clips = ClipDataset(path, "val", fields=FIELDS, scale=Scale(fields=("edge151",)))
    log, plain = SampleLog(evaluator(path), tmp_path), evaluator(path)
    for batch in DataLoader(clips, batch_size=2, collate_fn=pad_clips):
        batch["lengths"]["edge151"][1] -= 30  # all clips of this corpus are equally long
        batch["length"][1] -= 30
        batch["id"][1] = batch["id"][1].replace("+210", "+180")
        log.update(batch["edge151"], batch)
        lengths = batch["lengths"]["edge151"]
        plain.update(batch["edge151"], batch["id"], music=batch["librosa35"], lengths=lengths)
    kept = [(sample.of.length, len(sample.columns)) for sample in log._samples]
    assert kept == [(210, 210), (180, 180)]
    done = log.finish(0)
    assert done.report is not None
    for name in ("bas", "pfc", "fid_k"):
        assert done.report[name].value == pytest.approx(plain.compute()[name].value, rel=1e-9)
    assert done.page is not None


def test_samples_that_cannot_be_measured_are_a_warning(path: Path, tmp_path: Path) -> None:
    log = SampleLog(evaluator(path), tmp_path)
    batch = next(iter(DataLoader(windows(path), batch_size=2)))
    log.update(torch.full_like(batch["edge151"], float("nan")), batch)
    with pytest.warns(UserWarning, match="no sample could be measured"):
        done = log.finish(1)
    assert done.report is None
    assert done.numbers == {"samples/left_out": 2.0}
    assert done.page is not None  # the truth is drawn, and a note has the reason
    assert "sample" in done.page.read_text(encoding="utf-8")


def test_pages_replace_pages_alone(path: Path, tmp_path: Path) -> None:
    log = SampleLog(evaluator(path), tmp_path)
    batch = next(iter(DataLoader(windows(path), batch_size=1)))
    foreign = tmp_path / "step-00000002.html"
    foreign.write_text("mine")
    for step, wanted in ((1, True), (1, True), (2, False)):
        log.update(batch["edge151"], batch)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore" if not wanted else "error")
            assert (log.finish(step).page is not None) is wanted
    assert foreign.read_text() == "mine"
    inside = SampleLog(evaluator(path), path / "walls")
    inside.update(batch["edge151"], batch)
    with pytest.warns(UserWarning, match="cannot be written into a dataset"):
        assert inside.finish(1).page is None


def test_refusals(path: Path, tmp_path: Path) -> None:
    whole = evaluator(path)
    with raises_message(UsageError, "page"):
        SampleLog(whole, tmp_path, wall=0)
    with raises_message(UsageError, "pad_clips"):
        SampleLog(whole).update(np.zeros((1, 150, 151)), {"motion": 1})
    with raises_message(UsageError, "validation"):
        SampleLog(whole).finish(1)


# ---------------------------------------------------------------------------------------------------------- Lightning


def lightning_run(path: Path, folder: Path, *, generates: bool = True, **keys: Any) -> Any:
    """Train a layer for two epochs, whose module generates samples; return trainer, callback and module."""
    lightning = pytest.importorskip("lightning")
    from lightning.pytorch.loggers import CSVLogger

    from dancedata.training import LightningSamples

    class Dance(lightning.LightningModule):  # type: ignore[misc, name-defined]
        def __init__(self) -> None:
            super().__init__()
            self.model = torch.nn.Linear(35, 151)
            self.drawn: list[float] = []

        def training_step(self, batch: Any, number: int) -> Any:
            self.drawn.append(float(torch.rand(())))
            return torch.nn.functional.mse_loss(self.model(batch["librosa35"]), batch["edge151"])

        def validation_step(self, batch: Any, number: int) -> None:
            pass

        def sample(self, batch: Any) -> Any:
            assert not self.training
            assert not torch.is_grad_enabled()
            return batch["edge151"] + 1e-3 * torch.randn(batch["edge151"].shape)

        def configure_optimizers(self) -> Any:
            return torch.optim.AdamW(self.parameters())

    if not generates:
        del Dance.sample
    torch.manual_seed(0)
    callback = LightningSamples(SampleLog(evaluator(path), folder / "walls", wall=2), **keys)
    trainer = lightning.Trainer(
        max_epochs=2, accelerator="cpu", enable_progress_bar=False, enable_model_summary=False,
        enable_checkpointing=False, logger=CSVLogger(folder, name="log", version=0), callbacks=[callback],
    )  # fmt: skip
    module = Dance()
    trainer.fit(module, DataLoader(windows(path, "train"), 8), DataLoader(windows(path), 4))
    return trainer, callback, module


@pytest.mark.filterwarnings("ignore")  # Lightning's own: workers, deprecated names of torch
def test_lightning_logs_scores_and_writes_pages(path: Path, tmp_path: Path) -> None:
    trainer, callback, module = lightning_run(path, tmp_path)
    steps = len(DataLoader(windows(path, "train"), 8))
    assert sorted(p.name for p in (tmp_path / "walls").iterdir()) == [
        f"step-{steps:08d}.html", f"step-{2 * steps:08d}.html"
    ]  # fmt: skip
    with open(tmp_path / "log/version_0/metrics.csv", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row.get("samples/n_clips")]
    assert [int(row["step"]) for row in rows] == [steps - 1, 2 * steps - 1]
    # The noise is the same in each validation, so the numbers are; they are those of an Evaluator with that noise.
    first, second = ({key: v for key, v in row.items() if key.startswith("samples/")} for row in rows)
    assert first == second
    assert callback.last.numbers["samples/left_out"] == 0
    for name, value in callback.last.numbers.items():
        assert float(trainer.callback_metrics[name]) == pytest.approx(value, rel=1e-6)  # Lightning's are float32
        assert float(second[name]) == pytest.approx(value, rel=1e-6)
    assert callback.last.report.clips == tuple(sorted(batch["id"] for batch in windows(path)))
    (tmp_path / "other").mkdir()
    _, _, plain = lightning_run(path, tmp_path / "other", sample=lambda module, batch: batch["edge151"])
    assert module.drawn == plain.drawn  # the training draws as without samples


@pytest.mark.filterwarnings("ignore")
def test_lightning_samples_some_batches(path: Path, tmp_path: Path) -> None:
    _, callback, _ = lightning_run(path, tmp_path, batches=1)
    assert len(callback.last.report.clips) == 4


@pytest.mark.filterwarnings("ignore")
def test_lightning_needs_something_that_generates(path: Path, tmp_path: Path) -> None:
    with raises_message(UsageError, "lambda"):
        lightning_run(path, tmp_path, generates=False)
    with raises_message(UsageError, "batches"):
        lightning_run(path, tmp_path, batches=0)


# --------------------------------------------------------------------------------------------------------- Accelerate


def of_rank(store: Path, folder: Path) -> None:
    """Sample the windows of val in a process of Accelerate, and write what it logged."""
    from accelerate import Accelerator
    from accelerate.state import AcceleratorState
    from accelerate.tracking import GeneralTracker

    AcceleratorState._reset_state(reset_partial_state=True)  # that of another test, in the process that was forked

    class Kept(GeneralTracker):  # type: ignore[misc, name-defined]
        name, requires_logging_directory, tracker = "kept", False, property(lambda self: self.rows)

        def __init__(self) -> None:
            super().__init__()
            self.rows: list[Any] = []

        def store_init_configuration(self, values: Any) -> None:
            pass

        def log(self, values: Any, step: int | None = None, **_: Any) -> None:
            self.rows.append([step, values])

    tracker = Kept()
    accelerator = Accelerator(cpu=True, log_with=tracker)
    accelerator.init_trackers("run")
    log = SampleLog(evaluator(store), folder / "walls", wall=2)
    for batch in accelerator.prepare(DataLoader(windows(store), 4)):
        log.update(batch["edge151"], batch)
    done = log.finish(7, accelerator=accelerator)
    assert done.report is not None
    rows = [accelerator.num_processes, tracker.rows, str(done.page), done.numbers, done.report.to_json()["scores"]]
    (folder / ("main.json" if accelerator.is_main_process else "other.json")).write_text(json.dumps(rows))


def test_accelerate_logs_scores_and_writes_one_page(path: Path, tmp_path: Path) -> None:
    """With one process, and with two, which are forks of this one."""
    launchers = pytest.importorskip("accelerate.launchers")
    for processes in (1, 2):
        (tmp_path / str(processes)).mkdir()
        launchers.debug_launcher(of_rank, (path, tmp_path / str(processes)), num_processes=processes)
    alone = SampleLog(evaluator(path))
    for batch in DataLoader(windows(path), batch_size=4):
        alone.update(batch["edge151"], batch)
    wanted = alone.finish(7)
    assert wanted.report is not None
    scores = json.loads(json.dumps(wanted.report.to_json()["scores"]))
    for processes in (1, 2):
        folder = tmp_path / str(processes)
        main = json.loads((folder / "main.json").read_text())
        page = str(folder / "walls" / "step-00000007.html")
        assert main == [processes, [[7, dict(wanted.numbers)]], page, dict(wanted.numbers), scores]
    other = json.loads((folder / "other.json").read_text())
    assert other[2:] == ["None", *main[3:]]
