"""What readers of captures with poses share: pictures that have moved or are missing, sizes, lenses, rows of poses matched by order."""
