"""What runs in the process that holds pycolmap."""
