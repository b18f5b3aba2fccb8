"""The contract of `rasterize`: shapes, kinds that are absent, extras, dtypes, and errors that name what is wrong."""

import sys
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from e4dgs.rasterizer import Camera, Convexes, Gaussians, rasterize

from .scenes import F64, Scene, make_camera, random_convexes, random_gaussians, random_scene


def scene() -> Scene:
    return random_scene(0, gaussians=5, convexes=4, degree=1)


@pytest.mark.parametrize("size", [(1, 1), (33, 17), (17, 33)])
@pytest.mark.parametrize("extras", [None, 0, 3])
def test_shapes_and_dtypes(size: tuple[int, int], extras: int | None) -> None:
    width, height = size
    frame = random_scene(0, gaussians=5, convexes=4, extras=extras, width=width, height=height).render()
    assert frame.color.shape == (height, width, 3)
    assert frame.alpha.shape == frame.depth.shape == (height, width)
    assert frame.extras.shape == (height, width, extras or 0)
    assert frame.visible_gaussians.shape == (5,)
    assert frame.visible_convexes.shape == (4,)
    assert {frame.color.dtype, frame.alpha.dtype, frame.depth.dtype, frame.extras.dtype} == {F64}
    assert frame.visible_gaussians.dtype == frame.visible_convexes.dtype == torch.bool


@pytest.mark.parametrize("gaussians", [None, 0])
@pytest.mark.parametrize("convexes", [None, 0])
def test_nothing_to_draw_is_the_background(gaussians: int | None, convexes: int | None) -> None:
    camera = make_camera(17, 33)
    background = torch.tensor([0.1, 0.2, 0.3], requires_grad=True)
    frame = rasterize(
        camera,
        None if gaussians is None else random_gaussians(0, gaussians),
        None if convexes is None else random_convexes(0, convexes),
        background,
        backend="reference",
    )
    assert torch.equal(frame.color, background.double().expand(33, 17, 3))
    assert not frame.alpha.any() and not frame.depth.any()
    frame.color.sum().backward()
    assert background.grad is not None and float(background.grad[0]) == 33 * 17


def test_everything_culled_is_the_background_with_zero_gradients() -> None:
    behind = scene()
    assert behind.gaussians is not None and behind.convexes is not None
    behind.gaussians.means[:, 2] -= 20
    behind.convexes.points[..., 2] -= 20
    leaves = behind.leaves()
    frame = behind.having(leaves).render()
    assert torch.equal(frame.color, behind.background.expand_as(frame.color))
    assert not frame.visible_gaussians.any() and not frame.visible_convexes.any()
    (frame.color.sum() + frame.depth.sum() + frame.alpha.sum()).backward()
    for name, leaf in leaves.items():
        assert leaf.grad is None or name == "background" or not leaf.grad.any(), name


def test_no_background_is_black() -> None:
    some = scene()
    black = replace(some, background=torch.zeros(3, dtype=F64)).render()
    assert torch.equal(rasterize(some.camera, some.gaussians, some.convexes, backend="reference").color, black.color)


def test_a_kind_without_extras_counts_as_zeros() -> None:
    some = random_scene(0, gaussians=5, convexes=4, extras=2)
    assert some.gaussians is not None and some.convexes is not None
    for kind in ("gaussians", "convexes"):
        owner = getattr(some, kind)
        absent = replace(some, **{kind: replace(owner, extras=None)}).render()
        zeros = replace(some, **{kind: replace(owner, extras=torch.zeros_like(owner.extras))}).render()
        assert torch.equal(absent.extras, zeros.extras)
        alone = replace(some, **{kind: None}).render()  # type: ignore[arg-type]
        assert alone.extras.shape[-1] == 2


def test_extras_are_blended_with_the_colours_weights() -> None:
    some = random_scene(0, gaussians=5, convexes=4, degree=None)
    assert some.gaussians is not None and some.convexes is not None
    some.gaussians.extras, some.convexes.extras = some.gaussians.colors, some.convexes.colors
    frame = replace(some, background=torch.zeros(3, dtype=F64)).render()
    assert torch.allclose(frame.extras, frame.color, atol=1e-14)


def test_float32_and_float64_inputs_may_be_mixed_and_both_get_gradients() -> None:
    some = scene()
    leaves = some.leaves()
    leaves = {name: x.detach().to(torch.float32 if n % 2 else F64).requires_grad_() for n, (name, x) in enumerate(leaves.items())}
    some.having(leaves).render().color.sum().backward()
    for name, leaf in leaves.items():
        assert leaf.grad is not None and leaf.grad.dtype == leaf.dtype, name


def test_visible_is_what_some_pixel_blends() -> None:
    some = scene()
    assert some.gaussians is not None
    some.gaussians.means[1] = torch.tensor([50.0, 0, 0])  # outside the image
    some.gaussians.opacities[2] = 0.5 / 255
    visible = some.render().visible_gaussians
    assert not visible[1] and not visible[2]
    assert bool(visible[[0, 3, 4]].all())


def broken(**change: object) -> Callable[[Scene], Scene]:
    def apply(some: Scene) -> Scene:
        for name, value in change.items():
            kind, field = name.split("_", 1)
            some = replace(some, **{kind: replace(getattr(some, kind), **{field: value})})
        return some

    return apply


BAD_ARGUMENTS = {
    "means": (broken(gaussians_means=torch.zeros(5, 2)), ValueError, r"gaussians.means must have shape \[\*, 3\], got \[5, 2\]"),
    "quats": (broken(gaussians_quats=torch.zeros(4, 4)), ValueError, r"gaussians.quats must have shape \[5, 4\], got \[4, 4\]"),
    "scales": (broken(gaussians_scales=torch.zeros(5)), ValueError, r"gaussians.scales must have shape \[5, 3\]"),
    "opacities": (broken(gaussians_opacities=torch.zeros(5, 1)), ValueError, r"gaussians.opacities must have shape \[5\]"),
    "dtype": (broken(gaussians_scales=torch.ones(5, 3, dtype=torch.int64)), TypeError, "gaussians.scales must be float32 or float64"),
    "half": (broken(convexes_tau=torch.ones(4, dtype=torch.float16)), TypeError, "convexes.tau must be float32 or float64"),
    "list": (broken(convexes_kappa=[1, 2, 3, 4]), TypeError, "convexes.kappa must be a torch.Tensor, got list"),
    "two points": (broken(convexes_points=torch.zeros(4, 2, 3)), ValueError, "convexes.points must have 3 to 8 points"),
    "nine points": (broken(convexes_points=torch.zeros(4, 9, 3)), ValueError, "convexes.points must have 3 to 8 points"),
    "no colour": (broken(gaussians_sh=None), ValueError, "gaussians: give exactly one of sh and colors, got neither"),
    "two colours": (broken(convexes_colors=torch.zeros(4, 3)), ValueError, "convexes: give exactly one of sh and colors, got both"),
    "sh": (broken(gaussians_sh=torch.zeros(5, 5, 3)), ValueError, "gaussians.sh must have 1, 4, 9 or 16 coefficients"),
    "extras": (broken(gaussians_extras=torch.zeros(5, 2), convexes_extras=torch.zeros(4, 3)), ValueError, "must have one width"),
    "background": (lambda s: replace(s, background=torch.zeros(4)), ValueError, r"background must have shape \[3\]"),
    "background nan": (lambda s: replace(s, background=torch.tensor([0, float("nan"), 0])), ValueError, "background must be finite"),
    "tiles": (
        lambda s: replace(s, tiles=torch.ones(1, 3, dtype=torch.bool)),
        ValueError,
        r"tiles must have shape \[2, 3\] for 37 x 23 px, got",
    ),
    "tiles dtype": (lambda s: replace(s, tiles=torch.ones(2, 3)), TypeError, "tiles must be a bool torch.Tensor, got torch.float32"),
    "kind": (lambda s: replace(s, gaussians=s.convexes), TypeError, "gaussians must be Gaussians or None, got Convexes"),
}


@pytest.mark.parametrize(("change", "error", "message"), BAD_ARGUMENTS.values(), ids=BAD_ARGUMENTS.keys())
def test_bad_arguments_are_named(change: Callable[[Scene], Scene], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        change(scene()).render()


def camera_with(**change: object) -> Camera:
    return replace(make_camera(), **change)  # type: ignore[arg-type]


def K_with(row: int, column: int, value: float) -> torch.Tensor:
    K = make_camera().K
    K[row, column] = value
    return K


def pose_with(row: int, column: int, value: float) -> torch.Tensor:
    pose = make_camera().cam_from_world
    pose[row, column] = value
    return pose


BAD_CAMERAS = {
    "skew": (camera_with(K=K_with(0, 1, 0.5)), ValueError, "camera.K has skew"),
    "nan": (camera_with(K=K_with(0, 2, float("nan"))), ValueError, "camera.K must be finite"),
    "focal": (camera_with(K=K_with(1, 1, -30.0)), ValueError, "camera.K must have positive focal lengths"),
    "shape": (camera_with(K=torch.eye(4)), ValueError, r"camera.K must have shape \[3, 3\]"),
    "pose inf": (camera_with(cam_from_world=pose_with(0, 3, float("inf"))), ValueError, "camera.cam_from_world must be finite"),
    "pose transposed": (camera_with(cam_from_world=make_camera().cam_from_world.T), ValueError, "is it transposed"),
    "width": (camera_with(width=0), ValueError, "camera.width must be at least 1"),
    "height": (camera_with(height=2.5), TypeError, "camera.height must be an int"),
    "near": (camera_with(near=0.0), ValueError, "camera.near must be positive"),
    "array": (camera_with(K=make_camera().K.numpy()), TypeError, "camera.K must be a torch.Tensor"),
}


@pytest.mark.parametrize("validate", [False, True])
@pytest.mark.parametrize(("camera", "error", "message"), BAD_CAMERAS.values(), ids=BAD_CAMERAS.keys())
def test_bad_cameras_always_raise(camera: Camera, error: type[Exception], message: str, validate: bool) -> None:
    with pytest.raises(error, match=message):
        rasterize(camera, backend="reference", validate=validate)


def test_a_camera_on_the_cpu_is_refused_while_a_cuda_graph_is_captured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "is_current_stream_capturing", lambda: True)
    with pytest.raises(RuntimeError, match=r"camera.K is on the CPU while a CUDA graph is being captured; move it"):
        scene().render("cuda")


BAD_VALUES = [
    ("gaussians.means", 3, float("nan"), r"gaussians.means\[3\] must be finite"),
    ("gaussians.quats", 1, 0.0, r"gaussians.quats\[1\] must be finite and non-zero"),
    ("gaussians.scales", 4, -1.0, r"gaussians.scales\[4\] must be finite and > 0"),
    ("gaussians.scales", 0, float("inf"), r"gaussians.scales\[0\]"),
    ("gaussians.opacities", 2, 1.5, r"gaussians.opacities\[2\] must be finite and in \[0, 1\], got 1.5"),
    ("gaussians.sh", 2, float("inf"), r"gaussians.sh\[2\]"),
    ("convexes.points", 3, float("-inf"), r"convexes.points\[3\] must be finite"),
    ("convexes.tau", 1, 0.0, r"convexes.tau\[1\] must be finite and > 0"),
    ("convexes.kappa", 2, -3.0, r"convexes.kappa\[2\] must be finite and > 0"),
    ("convexes.opacities", 0, -0.1, r"convexes.opacities\[0\] must be finite and in \[0, 1\]"),
]


@pytest.mark.parametrize(("name", "index", "value", "message"), BAD_VALUES)
def test_bad_values_raise_with_field_and_index_under_validate_and_cull_alone_without(
    name: str, index: int, value: float, message: str
) -> None:
    some = scene()
    tensors = some.tensors()
    tensors[name] = tensors[name].clone()
    tensors[name][index] = value
    bad = some.having(tensors)
    with pytest.raises(ValueError, match=message):
        bad.render(validate=True)

    # Culled alone: the picture and everybody else's gradients are those of the scene without it, its own are zero.
    kind = name.split(".")[0]
    others = torch.arange(len(tensors[name])) != index
    rest = {n: x[others] if n.startswith(kind) else x for n, x in tensors.items()}
    got_leaves, want_leaves = bad.leaves(), some.having(rest).leaves()
    got, want = bad.having(got_leaves).render(), some.having(rest).having(want_leaves).render()
    assert torch.equal(got.color, want.color) and torch.equal(got.depth, want.depth)
    got.color.sum().backward()
    want.color.sum().backward()
    for n, leaf in got_leaves.items():
        gradient, expected = leaf.grad, want_leaves[n].grad
        assert gradient is not None and expected is not None
        if n.startswith(kind):
            assert not gradient[index].any(), n
            gradient = gradient[others]
        assert torch.allclose(gradient, expected, rtol=1e-12, atol=1e-14), n


def test_good_values_pass_validation() -> None:
    scene().render(validate=True)


def test_an_unknown_backend_and_tensors_on_the_wrong_device_say_so() -> None:
    with pytest.raises(ValueError, match=r"'cuda' wants tensors on a CUDA device, got cpu; move them with"):
        scene().render("cuda")
    with pytest.raises(ValueError, match="backend must be"):
        scene().render("opengl")


def test_empty_kinds_carry_gradients_for_the_camera() -> None:
    camera = make_camera()
    K = camera.K.requires_grad_()
    empty = Gaussians(*(torch.zeros(0, n) for n in (3, 4, 3)), torch.zeros(0), colors=torch.zeros(0, 3))
    none = Convexes(torch.zeros(0, 6, 3), *(torch.zeros(0) for _ in range(3)), colors=torch.zeros(0, 3))
    frame = rasterize(camera, empty, none, backend="reference")
    (frame.color.sum() + frame.depth.sum()).backward()
    assert K.grad is None or not K.grad.any()


def test_kernels_that_cannot_be_loaded_give_one_error_with_the_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "e4dgs.rasterizer.cpu_backend", None)
    for backend in ("cpu", "auto"):
        with pytest.raises(RuntimeError, match=r"CPU kernels .* cannot be loaded \(.*cpu_backend.*reinstall"):
            scene().render(backend)
