"""Photos as cameras and phones leave them."""
