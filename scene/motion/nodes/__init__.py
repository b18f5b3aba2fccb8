"""Control nodes: rigid frames that carry the primitives near them."""
