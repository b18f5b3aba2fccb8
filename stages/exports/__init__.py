"""A trained model and its flow as files that other programs read, and the cameras that look at it."""
