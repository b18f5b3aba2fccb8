"""Image metrics of the field in float64. Images are RGB [H, W, 3] in [0, 1]; each file is one metric with its definition.

Imported one by one (`from .psnr import psnr`), so that who needs PSNR does not load torch for LPIPS.
"""
