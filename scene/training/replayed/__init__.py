"""Steps of training on a GPU as CUDA graphs."""
