"""Stage `evaluate`: compares renders with the captured pictures, in numbers and in pictures."""
