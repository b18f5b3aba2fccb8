"""Which kind of file a name stands for, among the kinds that belong to captures: pictures, videos, poses, depth, masks, lists, tracks."""

from __future__ import annotations

import posixpath
import re
from dataclasses import dataclass
from functools import lru_cache

from .names import IMAGE_SUFFIXES, is_image, is_video

_JPEG = "convert them to JPEG, for example with magick mogrify -format jpg"
_LIGHT = (
    "convert them to PNG coded as sRGB, since the numbers stand for {0} light, for example with "
    "oiiotool IN --colorconvert {1} sRGB -d uint8 -o OUT.png"
)
_LINEAR = _LIGHT.format("linear", "linear")
_LOG = f"{_LIGHT.format('log or linear', 'SPACE')} (SPACE is theirs, such as linear)"
_RAW = "develop them to JPEG or to TIFF of 16 bits"
_MP4 = "export them as MP4"
_FLAT = "reframed to a flat view (Insta360 Studio, GoPro Player, DJI Studio)"
_RAWS = (
    *(".dng", ".nef", ".nrw", ".cr2", ".cr3", ".crw", ".arw", ".sr2", ".raf", ".orf", ".rw2", ".pef", ".srw", ".x3f", ".3fr", ".gpr"),
    *(".kdc", ".dcr", ".mrw", ".erf", ".iiq", ".rwl", ".mos"),
)
_CLOSED = {  # suffixes of pictures and videos that no layout reads: (name, what to do)
    **dict.fromkeys((".heic", ".heif", ".hif"), ("HEIC", _JPEG)),
    **dict.fromkeys((".avif", ".avifs"), ("AVIF", _JPEG)),
    ".jxl": ("JPEG XL", _JPEG),
    **dict.fromkeys((".jp2", ".j2k", ".jpf", ".jpx", ".j2c", ".jpc"), ("JPEG 2000", _JPEG)),
    **{suffix: (f"{suffix[1:].upper()} (camera raw)", _RAW) for suffix in _RAWS},
    **{suffix: (suffix[1:].upper(), "convert them to PNG") for suffix in (".ppm", ".pgm", ".pnm", ".tga", ".psd", ".pcx", ".qoi")},
    **dict.fromkeys((".sgi", ".rgb"), ("SGI", "convert them to PNG")),
    ".jxr": ("JPEG XR", _JPEG),
    **{suffix: (suffix[1:].upper(), _LINEAR) for suffix in (".exr", ".hdr")},
    ".dpx": ("DPX", _LOG),
    ".cin": ("Cineon", _LOG),
    ".mpo": ("MPO", _JPEG),
    ".insp": ("INSP", f"export them as JPEG, {_FLAT}"),
    **{suffix: (suffix[1:].upper(), "export them as JPEG") for suffix in (".lfr", ".lfp", ".ari", ".arx")},
}
_CLOSED_VIDEOS = {
    **{suffix: (suffix[1:].upper(), _MP4) for suffix in (".braw", ".crm", ".rmvb", ".svo", ".svo2", ".nev", ".cine", ".bag", ".mcap")},
    ".insv": ("INSV", f"{_MP4}, {_FLAT}"),
    ".osv": ("OSV", f"{_MP4}, {_FLAT}"),
    ".360": ("360", f"{_MP4}, {_FLAT}"),
    ".r3d": ("R3D", "unpack them if they are Record3D's archives, or export them as MP4"),
}
_LOW = (".lrv", ".lrf")  # of GoPro and Insta360, and of DJI
ROLES = {  # words in names of files and folders that say what a picture or an array shows in place of colours
    "depth": ("depth", "depths", "depthmap", "depthmaps", "depthimage", "disp", "disparity", "disparities"),
    "mask": (
        "mask",
        "masks",
        "seg",
        "segs",
        "segmentation",
        "segmentations",
        "semantic",
        "semantics",
        "label",
        "labels",
        "matte",
        "mattes",
        "alpha",
    ),
    "normal": ("normal", "normals"),
    "confidence": ("confidence", "confidences", "conf", "covisible"),
    "coordinate": ("coordinates", "coords"),
    "optical flow": ("flow", "flows", "optflow"),
}
# Of DJI's multispectral cameras: DJI_0010_MS_NIR.TIF beside DJI_0010_D.JPG, or DJI_0011.TIF to DJI_0015.TIF beside DJI_0010.JPG;
# and of thermal ones: DJI_20230606100030_0001_T.JPG beside _V, _W or _Z, and a_IR.jpg beside a_RGB.jpg.
_BAND = re.compile(r"(.+)_(?:ms_(?:b|g|r|re|nir)\.tiff?|ir\.jpe?g)|(dji_\d+)[1-5]\.tiff?|(dji_.+)_t\.jpe?g")
_VISIBLE = re.compile(r"(.+)_(?:d|rgb)\.jpe?g|(dji_\d+)0\.jpe?g|(dji_.+)_[vwz]\.jpe?g")
_COLOUR = ("color", "colour", "rgb", "image", "img", "left", "frame", "frames", "photo", "picture", "pic", "rgba", "beauty")
_ASIDE = ("map", "maps", "vis", "object", "dynamic", "enlarged", "forward", "backward", "instance")  # in names of what is no colour
_ARRAYS = (".npy", ".npz", ".pfm", ".exr", ".flo", ".tiff", ".tif", ".pgm", ".dpt", ".raw")
_CLOUDS = (".ply", ".las", ".laz", ".pcd", ".e57", ".pts", ".ptx", ".xyz")
_MESHES = (".obj", ".glb", ".gltf", ".usd", ".usdz", ".usda", ".usdc", ".fbx", ".stl", ".splat", ".spz", ".sog")
_TRACKS = (".srt", ".vtt", ".ass", ".gpx", ".kml", ".kmz", ".nmea", ".fit")
_SOUNDS = (".wav", ".mp3", ".m4a", ".aac", ".flac", ".ogg", ".opus")
ARCHIVES = (".zip", ".7z", ".rar", ".tar", ".tgz", ".gz", ".bz2", ".xz", ".zst")
_DATA = r"\.(json|jsonl|txt|csv|tsv|xml|npy|npz|ya?ml|log|toml|mat|out|bin)"
_POSES = re.compile(
    rf"(transforms?.*\.json|poses_bounds.*\.npy|models?\.json|(.*_)?meta(data)?\.json|dataset\.json|scene\.json|.*cameras?{_DATA}|cameras?_.*{_DATA}"
    rf"|(.*[^a-z])?(poses?|traj(ectory|ectories)?|extrinsics?|odometry|ground_?truth|w2c|c2w){_DATA}|(poses?|traj(ectory)?|extrinsics?)[^a-z].*{_DATA}"
    r"|.*\.nvm|bundle.*\.out|.*\.psx|.*\.psz|.*\.sfm|sfm_data.*|reconstruction.*\.json"
    r"|\d+_cam\.txt|(intri|extri)\.ya?ml|annots\.(npy|json)|.*\.(traj|pincam)|.*_colmap_sfm\.log)"  # MVSNet, EasyMocap, ZJU, ARKit, Tanks
)
_OTHER_POSES = re.compile(  # of programs that also export what is read: Nuke, RealityCapture, Agisoft, Pix4D, ContextCapture, matchmovers
    r".*\.(chan|rcproj|abc)|(.*[^a-z])?opk([^a-z].*)?\.(txt|csv)|.*blocks_?exchange.*\.xml|.*external_camera_parameters.*\.txt"
)
_CALIBRATIONS = re.compile(rf"((.*[^a-z])?(intrinsics?|calib|calibration|distortion)([^a-z].*)?{_DATA}|k\.txt)")
_LISTS = re.compile(
    r"((.*[^a-z])?(train|test|val|split|splits|images?|rgb|depth|frames?|filenames|file_list|list|associations?|associate|timestamps?|times)"
    r"([^a-z].*)?\.(txt|lst|csv))|splits?.*\.json"
)
_MOTIONS = re.compile(rf"(.*[^a-z])?(imu|accel(erometer)?|gyro(scope)?|gps|gnss|telemetry|tracks?|tracking)([^a-z].*)?{_DATA}")
_THUMBNAILS = re.compile(r"(eh)?thumbs.*\.db")  # Windows keeps them in every folder of pictures
_POSE_FOLDERS = (
    "cam",
    "cams",
    "camera",
    "cameras",
    "camera-paths",
    "camera_paths",
    "pose",
    "poses",
    "extrinsic",
    "extrinsics",
    "traj",
    "w2c",
    "c2w",
)
MODEL = ("cameras", "images", "points3d", "frames", "rigs", "project")  # files of a COLMAP model, by their stems


@dataclass(frozen=True)
class FileKind:
    """A kind of file. one, many: its name for one and for several files. advice: what to do with them; empty if some layout reads such
    files, or nothing is to be done. group: "picture", "video", "pose" or "other"."""

    one: str
    many: str
    group: str = "other"
    advice: str = ""


PICTURE = FileKind("picture", "pictures", "picture")
VIDEO = FileKind("video", "videos", "video")
POSE = FileKind("pose file", "pose files", "pose")
OTHER_POSE = FileKind(
    "pose file of another program",
    "pose files of other programs",
    "pose",
    "export the poses as a COLMAP model or transforms.json, with the program that wrote them",
)
THUMBNAIL = FileKind("thumbnail", "thumbnails")  # cameras write one for each clip
LOW = FileKind(
    "low-resolution copy of a video",
    "low-resolution copies of videos",
    "video",
    "pass the video in full resolution, or rename them to end in .mp4",
)
BAND = FileKind("picture of one band of light", "pictures of one band of light", "picture")  # of multispectral cameras
_DYNAMIC = "dynamic_mask_"
DYNAMIC = FileKind("mask of instant-ngp", "masks of instant-ngp", "picture")  # dynamic_mask_a.png: white is ignored
COPY = FileKind("picture in another size", "pictures in another size", "picture")
CALIBRATION = "calibration file"
_OTHERS = (
    ("point cloud", "point clouds", lambda name: name.endswith(_CLOUDS)),
    ("mesh or splat file", "mesh or splat files", lambda name: name.endswith(_MESHES)),
    ("subtitle or track", "subtitles or tracks", lambda name: name.endswith(_TRACKS) or _MOTIONS.fullmatch(name)),
    ("sound file", "sound files", lambda name: name.endswith(_SOUNDS)),
    (
        "COLMAP database",
        "COLMAP databases",
        lambda name: re.fullmatch(r"(.*[^a-z])?(database|colmap|features|matches)([^a-z].*)?\.db", name),
    ),
    ("database", "databases", lambda name: name.endswith(".db") and not _THUMBNAILS.fullmatch(name)),
    (CALIBRATION, f"{CALIBRATION}s", lambda name: _CALIBRATIONS.fullmatch(name)),
    ("list of files or times", "lists of files or times", lambda name: _LISTS.fullmatch(name)),
)


def kind_of(path: str) -> FileKind | None:
    """The kind of the file at `path` (with `/` between folders), by its name and those of its folders; None if it belongs to no kind that
    captures have."""
    folders, name = posixpath.split(path.lower())
    suffix = posixpath.splitext(name)[1]
    if suffix in _CLOSED or is_image(name) or suffix in _ARRAYS:
        if name.startswith(_DYNAMIC):
            return DYNAMIC
        role = role_of(name) or next((r for part in folders.split("/") if (r := _role_of_word(part))), None)
        if role is not None:
            return FileKind(f"{role} map", f"{role} maps", "picture") if role != "mask" else FileKind("mask", "masks", "picture")
    if suffix in _CLOSED:
        format, advice = _CLOSED[suffix]
        return FileKind(f"{format} picture", f"{format} pictures", "picture", advice)
    if suffix in _CLOSED_VIDEOS:
        format, advice = _CLOSED_VIDEOS[suffix]
        return FileKind(f"{format} video", f"{format} videos", "video", advice)
    if suffix in _LOW:
        return LOW
    if suffix == ".thm":
        return THUMBNAIL
    if is_image(name):
        return BAND if _BAND.fullmatch(name) else PICTURE
    if is_video(name):
        return VIDEO
    if name.endswith(ARCHIVES):
        return FileKind("archive", "archives", advice="unpack them, or pass such a file as the capture")
    if _OTHER_POSES.fullmatch(name):
        return OTHER_POSE
    if _POSES.fullmatch(name) or (folders.split("/")[-1] in _POSE_FOLDERS and re.search(f"{_DATA}$", name)):
        return POSE
    return next((FileKind(one, many) for one, many, fits in _OTHERS if fits(name)), None)


def clip_of(path: str) -> str:
    """What the path of a video shares with that of its low-resolution copy: GX010034.MP4 with GL010034.LRV, DJI_0001.MP4 with
    DJI_0001.LRF, VID_20240101_120000_00_001.mp4 with LRV_20240101_120000_01_001.lrv."""
    folder, name = posixpath.split(posixpath.splitext(path.lower())[0])
    name = re.sub(r"^g[hxl](?=\d{6}$)", "g", name)
    return posixpath.join(folder, re.sub(r"^(?:vid|lrv)(_\d{8}_\d{6})_\d\d(_\d+)$", r"\1\2", name))


def role_of(name: str) -> str | None:
    """What the name of a picture says that it shows in place of colours, such as "depth" for `frame-000000.depth.png`; None if nothing."""
    words = re.findall(r"[a-z]+", posixpath.splitext(name.lower())[0])
    return next((role for word in words if (role := _role_of_word(word))), None)


@lru_cache(10_000)
def _role_of_word(word: str) -> str | None:
    bare = re.sub(r"[-_.]?(maps?|images?)?[-_.]?\d*$", "", word) if word not in ROLES["depth"] else word
    return next((role for role, words in ROLES.items() if word in words or bare in words), None)


def colour_only(names: list[str]) -> list[str]:
    """`names` of pictures in one folder without those that show depth, masks, normals or one band of light of another one: their names
    have a word that says so, and are otherwise the same (`rgb_01.jpg` and `depth_01.png`)."""
    visible = {match.groups() for name in names if (match := _VISIBLE.fullmatch(name.lower()))}
    names = [name for name in names if not ((match := _BAND.fullmatch(name.lower())) and match.groups() in visible)]
    others = {name for name in names if role_of(name) is not None}
    if not others:
        return names
    colours = {subject_of(name) for name in names if name not in others}
    return [name for name in names if name not in others or subject_of(name) not in colours]


def subject_of(name: str) -> tuple[str, ...]:
    """The words and numbers of a name that do not say what is shown of it."""
    bare = posixpath.splitext(name.lower())[0].removeprefix(_DYNAMIC)
    bare = re.sub(r"\.(mask|" + "|".join(suffix[1:] for suffix in IMAGE_SUFFIXES) + r")(?![^.])", "", bare)  # a.jpg.mask.png of a.jpg
    parts = re.findall(r"[a-z]+|\d+", bare)
    numbers = (part.lstrip("0") or "0" if part.isdigit() else part for part in parts)  # mask_0.png of frame_0000.png
    return tuple(part for part in numbers if part not in _COLOUR and part not in _ASIDE and not _role_of_word(part))
