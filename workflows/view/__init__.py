"""`e4dgs view`: the scene in a browser, finished or while it trains."""
