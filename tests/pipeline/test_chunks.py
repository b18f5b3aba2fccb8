"""Arrays read and written without zarr are those that zarr reads and writes, whatever their type, shape and chunks; every damaged byte is
found."""

import errno
import json
import os

import numpy as np
import pytest
import zarr
from e4dgs.pipeline import Artifact, ArtifactError, ArtifactWriter, Store
from e4dgs.pipeline.errors import DamagedError
from e4dgs.pipeline.storage.chunks import layout_of

TYPES = ["bool", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float16", "float32", "float64"]
SHAPES = {
    (): (),
    (7,): (7,),
    (0, 3): (1, 3),
    (5, 3): (2, 3),
    (6, 4): (2, 4),
    (5, 7, 2): (2, 3, 2),
    (4, 1, 600, 500): (3, 1, 600, 500),
}


def test_every_type_and_shape_reads_as_zarr_reads_it(quick_folder):
    writer = ArtifactWriter(quick_folder / "a")
    random = np.random.default_rng(0)
    expected = {}
    for kind in TYPES:
        for k, (shape, chunks) in enumerate(SHAPES.items()):
            if kind != "uint8" and len(shape) > 3:
                continue
            data = (random.random(shape) * 200).astype(kind)
            writer.create(f"{kind}_{k}", shape, kind, chunks)[...] = data
            expected[f"{kind}_{k}"] = data
    writer.finish({})
    artifact = Artifact(quick_folder / "a")
    for name, data in expected.items():
        assert layout_of(json.loads((artifact.path / name / "zarr.json").read_text())) is not None
        found = artifact.read(name)
        assert found.dtype == data.dtype and found.shape == data.shape and found.flags.writeable, name
        np.testing.assert_array_equal(found, data)
        np.testing.assert_array_equal(artifact.array(name)[...], data)


def test_every_type_and_shape_is_written_as_zarr_writes_it(quick_folder):
    random = np.random.default_rng(0)
    one, other = ArtifactWriter(quick_folder / "one"), ArtifactWriter(quick_folder / "other")
    for kind in [*TYPES, ">f4"]:
        for k, shape in enumerate([*SHAPES, (5 << 20,), (3, 7 << 20)]):
            if kind != "uint8" and len(shape) > 0 and max(shape) > 100:
                continue
            data = np.asarray(random.random(shape) * 200).astype(kind)
            if data.ndim == 3:
                data = data[::-1, :, ::-1]  # as views often are, not in one piece
            name = f"{kind.replace('>', 'big_')}_{k}"
            one.write(name, data)
            grid = json.loads((one.path / name / "zarr.json").read_text())["chunk_grid"]
            other.create(name, shape, kind, grid["configuration"]["chunk_shape"])[...] = data
    assert one.finish({}) == other.finish({}), "the digests are of all bytes of all files"


@pytest.mark.parametrize("kind", TYPES)
def test_an_array_without_dimensions_is_read_into_its_own_memory(quick_folder, kind):
    """Not into a scalar beside it: for bool that would be NumPy's one `np.False_`, which would then be true for everyone."""
    writer = ArtifactWriter(quick_folder / "a")
    writer.create("x", (), kind, ())[...] = 1
    writer.finish({})
    used = [np.zeros((), kind) for _ in range(100)]  # NumPy hands their memory out again as it is
    del used
    found = Artifact(quick_folder / "a").read("x")
    assert found == 1 and bool(np.True_) and not bool(np.False_)


def test_a_layout_that_is_not_ours_is_read_by_zarr(quick_folder):
    """As an artifact of a later version may have it."""
    writer = ArtifactWriter(quick_folder / "a")
    group = zarr.open_group(writer.path, mode="a", zarr_format=3)
    data = np.arange(12.0).reshape(3, 4)
    codecs = {"compressors": [zarr.codecs.GzipCodec(), zarr.codecs.Crc32cCodec()], "config": {"write_empty_chunks": True}}
    group.create_array("other", shape=(3, 4), dtype="float64", chunks=(2, 4), **codecs)[...] = data
    big = zarr.codecs.BytesCodec(endian="big")
    group.create_array("big", shape=(3, 4), dtype="float64", chunks=(2, 4), serializer=big, **codecs)[...] = data
    writer.finish({})
    artifact = Artifact(writer.path)
    for name in ("other", "big"):
        assert layout_of(json.loads((artifact.path / name / "zarr.json").read_text())) is None
        np.testing.assert_array_equal(artifact.read(name), data)


@pytest.fixture
def small(quick_folder) -> Artifact:
    store = Store(quick_folder / "store")
    with store.lock("s", "k"), store.writing("s", "k") as writer:
        writer.create("x", (3, 2), np.float32, (2, 2), unit="px")[...] = [[1, 2], [3, 4], [5, 6]]
        writer.attrs["a"] = [1, 2]
        writer.info["seconds"] = 0.5
        return store.publish(writer, "s", "k", {"seeds": {}, "log": ["done"]})


def test_every_byte_of_every_file_counts(small):
    """One bit of each byte in turn; a change of the manifest that leaves its JSON what it was loses nothing."""
    flipped = 0
    for file in (*small.manifest["files"], "manifest.json"):
        path = small.path / file
        good = path.read_bytes()
        for position in range(len(good)):
            bad = bytearray(good)
            bad[position] ^= 1 << (position % 8)
            path.write_bytes(bad)
            if file == "manifest.json" and same_json(bad, good):
                continue
            flipped += 1
            with pytest.raises(ArtifactError) as caught:
                Artifact(small.path).verify()
            assert str(path) in str(caught.value) or file == "manifest.json", f"{file}, byte {position}: {caught.value}"
            if file.startswith("x/c/"):
                with pytest.raises(ArtifactError, match=r"array 'x' is damaged.*--force"):
                    Artifact(small.path).read("x")
        path.write_bytes(good)
    assert flipped > 1500
    Artifact(small.path).verify()


def test_every_length_of_every_file_counts(small):
    for file in (*small.manifest["files"], "manifest.json"):
        path = small.path / file
        good = path.read_bytes()
        for length in (*range(len(good)), len(good) + 1):
            path.write_bytes(good[:length] if length <= len(good) else good + b"\0")
            if file == "manifest.json" and length < len(good) and same_json(good[:length], good):
                continue
            with pytest.raises(ArtifactError, match=str(path)):
                Artifact(small.path)
        path.write_bytes(good)


def same_json(one: bytes, other: bytes) -> bool:
    try:
        return json.loads(bytes(one)) == json.loads(other)
    except ValueError:
        return False


def test_a_chunk_that_goes_while_an_artifact_is_open_is_no_zeros(small):
    (small.path / "x/c/1/0").unlink()
    with pytest.raises(ArtifactError, match=r"array 'x' is damaged .*x/c/1/0"):
        small.read("x")
    for read in (lambda: small.read("x", slice(2, 3)), lambda: small.array("x")[2:3]):  # slices go through zarr
        with pytest.raises(DamagedError, match=r"x/c/1/0.*has gone while"):
            read()
    assert small.read("x", slice(0, 2)).shape[0] == 2, "what is there can still be read"


@pytest.mark.parametrize("code", [errno.EACCES, errno.EMFILE])
@pytest.mark.parametrize("part", [..., slice(0, 2)], ids=["whole", "part"])
def test_a_chunk_that_cannot_be_read_now_is_no_damage(small, monkeypatch, code, part):
    """Making the result again would take an hour and change nothing."""

    def refuse(*_):
        raise OSError(code, os.strerror(code), str(small.path / "x/c/0/0"))

    monkeypatch.setattr("e4dgs.pipeline.storage.chunks._read", refuse)
    monkeypatch.setattr("zarr.storage._local._get", refuse)
    with pytest.raises(ArtifactError, match=rf"x/c/0/0: cannot be read \({os.strerror(code)}\)$"):
        small.read("x", part)


def test_a_chunk_of_another_artifact_is_no_chunk_of_this(small, quick_folder):
    """Its own checksum is right; the manifest's digest is not."""
    other = ArtifactWriter(quick_folder / "other")
    other.create("x", (3, 2), np.float32, (2, 2))[...] = 7
    other.finish({})
    content = (other.path / "x/c/0/0").read_bytes()
    chunk = small.path / "x/c/0/0"
    if len(content) == chunk.stat().st_size:
        chunk.write_bytes(content)
        with pytest.raises(ArtifactError, match="array 'x' is damaged"):
            small.read("x")
