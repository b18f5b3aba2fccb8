"""Recordings of devices and trackers that know their own poses, as they store or export them."""
