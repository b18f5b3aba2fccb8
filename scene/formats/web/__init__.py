"""The data of a scene as the web player reads them: quantised, compressed, and with stated errors (docs/player.md)."""
