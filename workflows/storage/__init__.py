"""What a workspace keeps, and the commands that look after it."""
