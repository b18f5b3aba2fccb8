"""Damage of any kind is found, and nothing half-written is believed."""

import json

import numpy as np
import pytest
from e4dgs.pipeline import Artifact, ArtifactError, ArtifactWriter, Runner, StageError, make_plan


@pytest.fixture
def artifact(tmp_path):
    """Three chunks of zeros and ones, a scalar, an empty array, attrs and info."""
    return make(tmp_path / "a")


def make(path, info=0.5, **attrs) -> Artifact:
    writer = ArtifactWriter(path)
    writer.create("chunked", (6, 4), np.float32, (2, 4), unit="px", doc="rows")[...] = np.repeat([[0], [1], [0]], 2, axis=0)
    writer.write("scalar", np.float64(3.5))
    writer.write("empty", np.zeros((0, 3), np.uint8))
    writer.write("half", np.array([[1.5, -2]], np.float16))
    writer.attrs.update({"b": 1, "a": [1, 2], **attrs})
    writer.info["seconds"] = info
    writer.finish({"seeds": {}})
    return Artifact(path)


def test_what_was_written_is_read(artifact):
    assert artifact.names() == ["chunked", "empty", "half", "scalar"]
    assert "chunked" in artifact and "other" not in artifact
    np.testing.assert_array_equal(artifact.read("chunked")[:, 0], [0, 0, 1, 1, 0, 0])
    assert artifact.read("chunked").dtype == np.float32 and artifact.read("half").tolist() == [[1.5, -2]]
    assert artifact.read("scalar") == 3.5 and artifact.read("empty").shape == (0, 3)
    assert artifact.array("chunked").attrs["unit"] == "px"
    assert artifact.attrs == {"a": [1, 2], "b": 1} and artifact.info == {"seconds": 0.5}
    artifact.verify()
    with pytest.raises(ArtifactError, match="no array 'other'; it has chunked, empty, half, scalar"):
        artifact.read("other")


def test_every_array_carries_a_checksum_and_every_chunk_is_stored(artifact):
    for name in artifact.names():
        codecs = [codec["name"] for codec in json.loads((artifact.path / name / "zarr.json").read_text())["codecs"]]
        assert codecs[-1] == "crc32c"
    assert sorted(path.name for path in (artifact.path / "chunked" / "c").iterdir()) == ["0", "1", "2"], "zeros are written too"


def test_large_arrays_are_cut_into_chunks(tmp_path):
    writer = ArtifactWriter(tmp_path / "a")
    pictures = np.arange(5 * 3000 * 3000, dtype=np.uint8).reshape(5, 3000, 3000)
    writer.write("pictures", pictures)
    writer.finish({})
    array = Artifact(tmp_path / "a").array("pictures")
    assert array.chunks == (1, 3000, 3000)
    np.testing.assert_array_equal(array[3], pictures[3])


def test_the_digest_covers_content_and_not_info(tmp_path, artifact):
    assert make(tmp_path / "b").digest == artifact.digest
    assert make(tmp_path / "c", info=99).digest == artifact.digest
    assert make(tmp_path / "d", a=[2, 1]).digest != artifact.digest


def test_any_flipped_byte_is_found(artifact):
    for path in sorted(p for p in artifact.path.rglob("*") if p.is_file()):
        good = path.read_bytes()
        for position in {0, len(good) // 2, len(good) - 1} if good else set():
            bad = bytearray(good)
            bad[position] ^= 0x40
            path.write_bytes(bad)
            with pytest.raises(ArtifactError):
                Artifact(artifact.path).verify()
        path.write_bytes(good)
    Artifact(artifact.path).verify()


def test_a_flipped_byte_in_a_chunk_is_found_when_it_is_read(artifact):
    chunk = artifact.path / "chunked" / "c" / "1" / "0"
    data = bytearray(chunk.read_bytes())
    data[5] ^= 1
    chunk.write_bytes(data)
    with pytest.raises(ArtifactError, match=r"array 'chunked' is damaged.*--force"):
        Artifact(artifact.path).read("chunked")


def test_truncated_missing_and_foreign_files_are_found_on_opening(artifact):
    chunk = artifact.path / "chunked" / "c" / "0" / "0"
    data = chunk.read_bytes()
    chunk.write_bytes(data[:-1])
    with pytest.raises(ArtifactError, match=r"c/0/0: the manifest says \d+ bytes"):
        Artifact(artifact.path)
    chunk.unlink()
    with pytest.raises(ArtifactError, match=r"c/0/0: this file is in the manifest but not on disk"):
        Artifact(artifact.path)
    chunk.symlink_to(artifact.path / "chunked" / "c" / "2" / "0")
    with pytest.raises(ArtifactError, match="c/0/0"):
        Artifact(artifact.path)
    chunk.unlink()
    chunk.write_bytes(data)
    (artifact.path / "chunked" / "c" / "9").write_bytes(b"")
    with pytest.raises(ArtifactError, match=r"c/9: this file is not in the manifest"):
        Artifact(artifact.path)


def test_nothing_is_believed_without_a_manifest(artifact):
    manifest = artifact.path / "manifest.json"
    content = json.loads(manifest.read_text())
    manifest.unlink()
    with pytest.raises(ArtifactError, match="no manifest, so the artifact was never finished"):
        Artifact(artifact.path)
    manifest.write_text(json.dumps(content)[:-10])
    with pytest.raises(ArtifactError, match="manifest cannot be read"):
        Artifact(artifact.path)
    content["files"]["scalar/c"][0] += 1
    manifest.write_text(json.dumps(content))
    with pytest.raises(ArtifactError, match="manifest is damaged"):
        Artifact(artifact.path)


def test_objects_and_values_that_are_no_json_are_refused(tmp_path):
    writer = ArtifactWriter(tmp_path / "a")
    with pytest.raises(StageError, match="array 'words': dtype object cannot be stored"):
        writer.write("words", np.array(["a", None], dtype=object))
    writer.attrs["error"] = float("nan")
    with pytest.raises(StageError, match="not JSON"):
        writer.finish({})


@pytest.mark.parametrize("damage", ["truncate", "remove manifest", "remove chunk"])
def test_a_run_makes_a_damaged_result_again(bench, damage):
    first = Runner(bench.job()).run()[2].artifact
    bench.runs()
    chunk = first.path / "values" / "c" / "0"
    if damage == "truncate":
        chunk.write_bytes(chunk.read_bytes()[:-1])
    else:
        (chunk if damage == "remove chunk" else first.path / "manifest.json").unlink()
    row = make_plan(bench.job())[2]
    assert row.state == "run" and row.reason.startswith("damaged: ")
    outcomes = Runner(bench.job()).run()
    assert bench.runs() == ["clipped"]
    assert outcomes[3].state == "cached" and outcomes[2].artifact.read("values").tolist() == [1, 2, 2]
    assert [problem for _, _, problem in bench.store.verify() if problem] == []
