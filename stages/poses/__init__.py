"""Stage `poses`: structure from motion for captures without camera poses."""
