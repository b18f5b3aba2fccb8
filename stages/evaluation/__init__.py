"""The work of stage `evaluate`: renders against the capture's own pictures, in numbers and in pictures."""
