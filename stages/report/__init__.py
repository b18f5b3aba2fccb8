"""The report of a scene, one HTML file."""
