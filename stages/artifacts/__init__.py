"""Typed readers and writers of the artifacts that stages exchange."""
