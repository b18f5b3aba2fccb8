"""What a workspace stores, and the commands that manage it."""
