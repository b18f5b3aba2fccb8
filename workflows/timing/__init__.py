"""`--time`: the best result in a given time on this machine. See DESIGN.md of the folder above."""
