"""`e4dgs view`: shows a scene in the browser, finished or while it trains."""
