"""What users of this field reported as NaN, corruption or crashes, and the tests that hold it: every test that the table names exists."""

import ast
from collections import Counter
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parents[1]
# A failure, and for each file below tests/ the tests that would show it.
FAILURES = {
    "Inf or NaN in one scale corrupts tile keys; the others must stay bit-identical": {
        "rasterizer/test_robustness.py": ["test_one_poisoned_primitive_leaves_all_others_bit_identical"],
    },
    "N = 0, everything culled, 1x1 and 17x33 images": {
        "rasterizer/test_robustness.py": ["test_any_size_with_nothing_something_and_everything_culled"],
        "rasterizer/test_rasterize.py": [
            "test_nothing_to_draw_is_the_background",
            "test_everything_culled_is_the_background_with_zero_gradients",
        ],
        "rasterizer/test_kernels_against_reference.py": ["test_random_scenes"],
    },
    "zero, tiny, huge quaternions": {
        "rasterizer/test_robustness.py": [
            "test_a_zero_quaternion_is_culled_alone",
            "test_tiny_and_huge_quaternions_are_rotations_like_any_other",
        ],
        "stress/test_conditioning.py": [
            "test_quaternions_of_any_norm_have_the_gradients_of_the_reference",
            "test_quaternions_whose_components_differ_by_1e30",
        ],
    },
    "needles 1e-6:1, det near 0": {
        "stress/test_conditioning.py": ["test_needles_and_plates_of_1e_6_to_1", "test_a_needle_through_many_tiles"],
        "rasterizer/test_robustness.py": ["test_needles_are_finite"],
    },
    "determinant ratios that underflow": {
        "stress/test_conditioning.py": [
            "test_determinant_ratios_that_underflow",
            "test_determinants_that_are_huge",
            "test_a_far_gaussian_under_a_long_lens",
        ],
    },
    "stacks of 1000 layers at alpha 0.99, 10,000 layers at 0.004": {
        "stress/test_stacks.py": ["test_stacks_of_1000_at_0_99_and_10_000_at_0_004", "test_every_gradient_of_a_stack"],
        "rasterizer/test_robustness.py": ["test_deep_stacks_against_the_closed_form"],
    },
    "log-sum-exp at arguments of 1e4": {
        "stress/test_log_sum_exp.py": [
            "test_arguments_of_1e4_have_the_image_and_gradients_of_the_reference",
            "test_the_gradient_of_tau_at_arguments_of_1e4",
            "test_soft_and_sharp_images_agree_over_nine_decades",
        ],
        "rasterizer/test_robustness.py": ["test_log_sum_exp_at_large_arguments"],
    },
    "0 x Inf": {
        "stress/test_log_sum_exp.py": ["test_zero_times_infinity_in_tau_and_kappa"],
        "rasterizer/test_robustness.py": ["test_extreme_values_give_finite_pictures_and_gradients"],
    },
    "hulls: collinear, coincident, two distinct points": {
        "stress/test_hulls.py": ["test_flat_hulls_are_culled_alone_with_zero_gradient", "test_a_hull_of_a_few_float32_steps"],
        "rasterizer/test_hull.py": [
            "test_degenerate_hulls_are_culled_with_zero_gradient",
            "test_a_point_within_rounding_of_an_edge_is_no_corner",
            "test_kernels_take_the_same_corners_for_many_hulls_at_once",
        ],
    },
    "hulls: equal angles": {
        "stress/test_hulls.py": ["test_points_at_equal_angles", "test_points_at_equal_angles_seen_from_aside"],
        "rasterizer/test_hull.py": ["test_corners_are_the_extreme_points_each_once"],
    },
    "hulls: any permutation of the points": {
        "stress/test_hulls.py": ["test_any_permutation_of_the_points"],
        "rasterizer/test_hull.py": ["test_any_order_of_the_points_gives_the_same_render"],
    },
    "points behind the camera while the centroid is in front": {
        "stress/test_hulls.py": ["test_each_point_behind_the_camera_while_the_centroid_is_in_front"],
        "rasterizer/test_robustness.py": ["test_points_behind_the_camera_cull_the_convex_though_its_centroid_is_in_front"],
    },
    "footprint of 1e6 px, memory bounded": {
        "stress/test_memory.py": ["test_a_footprint_of_1e6_px_in_bounded_memory"],
        "rasterizer/test_robustness.py": ["test_a_footprint_of_a_million_pixels"],
    },
    "tiled against brute force": {
        "stress/test_tiles.py": ["test_tiled_against_brute_force"],
        "rasterizer/test_cpu_kernels.py": ["test_bounds_cut_no_visible_tail"],
    },
    "0.5x to 4x resolution of the same convex": {
        "stress/test_tiles.py": [
            "test_a_convex_at_0_5_to_4_times_the_resolution",
            "test_sharpness_does_not_depend_on_resolution",
            "test_pixels_that_look_along_one_ray_agree_at_any_resolution",
        ],
        "rasterizer/test_hull.py": ["test_a_convex_looks_the_same_at_any_resolution"],
    },
    "W != H finite differences": {
        "stress/test_finite_differences.py": ["test_central_differences_where_width_and_height_differ"],
        "rasterizer/test_gradients.py": ["test_central_differences"],
    },
    "scene and camera moved by 1e6": {
        "stress/test_far_from_origin.py": [
            "test_scene_and_camera_moved_by_1e6_in_float32",
            "test_what_rounding_of_float32_inputs_costs_at_1e6",
            "test_a_scene_of_ordinary_size_at_1e4",
        ],
        "rasterizer/test_robustness.py": ["test_scene_and_camera_moved_together_look_the_same"],
    },
    "bounding boxes flat or huge, points outside, t outside [0, 1]": {
        "stress/test_field_box.py": [
            "test_flat_and_huge_boxes_points_outside_and_times_outside_0_1",
            "test_points_outside_the_box_are_at_its_faces",
            "test_times_outside_0_1_are_the_ends",
            "test_one_position_that_is_not_finite_stays_inside_the_planes",
        ],
    },
    "antialiased: needles, scales over six decades, what crosses the near plane": {
        "stress/test_conditioning.py": ["test_compensation_of_scales_over_six_decades"],
        "rasterizer/test_kernels_against_reference.py": ["test_primitives_that_cross_the_near_plane"],
        "rasterizer/test_antialiased.py": ["test_a_disc_without_an_area_is_culled_with_zero_gradient"],
    },
    "one frame": {
        "stress/test_field_box.py": ["test_with_one_frame_nothing_depends_on_time"],
        "scene/test_hexplane.py": ["test_one_time_and_one_cell_are_allowed"],
    },
    "two runs and 1, 2, 4 threads bit-equal": {
        "stress/test_threads.py": [
            "test_ten_runs_with_1_2_and_4_threads_are_bit_equal",
            "test_equal_depths_keep_their_order_with_any_number_of_threads",
        ],
        "scene/test_hexplane.py": ["test_gradients_are_bit_equal_for_any_number_of_threads"],
        "scene/test_photometric.py": ["test_bit_equal_for_any_number_of_threads"],
    },
    "primitive budget respected": {
        "stress/test_budget.py": ["test_primitive_budget_respected", "test_small_images_have_a_budget_of_their_own"],
        "scene/test_trainer.py": ["test_training_learns_the_scene_within_the_budget"],
    },
}


def collected(path: str) -> set[str]:
    """Names that pytest takes for tests: functions at the top of a test file, each defined once (a second one hides the first)."""
    tree = ast.parse((TESTS / path).read_text())
    names = Counter(node.name for node in tree.body if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"))
    return {name for name, count in names.items() if count == 1}


def test_every_reported_failure_has_a_row() -> None:
    assert len(FAILURES) == 22


@pytest.mark.parametrize("failure", FAILURES)
def test_the_named_tests_exist(failure: str) -> None:
    assert FAILURES[failure]
    for path, names in FAILURES[failure].items():
        assert Path(path).name.startswith("test_") and names
        missing = set(names) - collected(path)
        assert not missing, f"{path} lacks {missing}"
