"""The usual image metrics in float64. Images are RGB [H, W, 3] in [0, 1]; each file has one metric and its definition.

Import them one by one (`from .psnr import psnr`), so that PSNR alone does not load torch, which LPIPS needs.
"""
