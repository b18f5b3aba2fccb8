"""The same computations as a good user of torch would write them: what the kernels are measured against."""
