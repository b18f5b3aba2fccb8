"""What the steps of a training cost: measured by a few of them, and summed up for any number."""
