"""The source that a stage's run reaches, as digests: keys hold them, so that no result of other code is ever taken for this one's."""
