"""What a stage takes of a machine: threads, memory."""
