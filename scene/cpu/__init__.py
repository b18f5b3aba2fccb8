"""What runs on the CPU in place of plain torch: native kernels, and the functions that call them."""
