"""What training minimises: the image terms and the edge terms of Eq. 8 and 9, and the priors on motion."""
