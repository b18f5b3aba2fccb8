"""The work of stage `evaluate`: compares renders with the captured pictures, in numbers and in pictures."""
