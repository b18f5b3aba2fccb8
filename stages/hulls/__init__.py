"""Stage `hulls`: chooses the Gaussians that become convexes."""
