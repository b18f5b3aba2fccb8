"""Exports a trained model and its flow as files for other programs, and has camera paths through the scene."""
