"""The work of stages `coarse`, `hulls` and `fine`: from frames and flow to a trained model."""
