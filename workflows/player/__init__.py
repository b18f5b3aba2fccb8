"""The web player: a page that shows a scene in any browser, from one file."""
