"""Names that become names of files and folders: letters and digits of any script, '.', '_' and '-'."""

from __future__ import annotations

import re
import unicodedata

from .files import digest_bytes

CHARACTERS, BYTES = 100, 200  # of a name at most; a file name has at most 255 bytes in UTF-8, and endings are added
RULE = f"use up to {CHARACTERS} letters, digits, '.', '_' and '-' ({BYTES} bytes in UTF-8), a letter or digit first"
# Format characters of category Cf are left out, too. A name with characters that nobody sees could not be typed.
_UNSEEN = re.compile("[\u034f\ufe00-\ufe0f\U000e0100-\U000e01ef]")


def composed(name: str) -> str:
    """``name`` in Unicode's composed form (NFC), so that a letter with an accent is one character, however it was typed or stored."""
    return unicodedata.normalize("NFC", name)


def is_safe(name: str) -> bool:
    """Whether a name follows `RULE`, in its composed form: it stays in its folder, is not hidden, and leaves room for endings."""
    return name[:1].isalnum() and _fits(name) and only_safe(name) == name


def safe_name(text: str, characters: int = 80) -> str:
    """``text`` as a name for which `is_safe` is true, of at most ``characters``; "" if it has no letter and no digit."""
    return shortened(only_safe(text).strip("-._"), characters)


def only_safe(text: str) -> str:
    """``text`` in its composed form, with '-' in place of each run of other characters than letters, digits, '.', '_' and '-'.

    Accents and vowel signs belong to the letter before them. Characters that are not seen are left out.
    """
    result = ""
    other = False  # the last character was replaced
    for character in _UNSEEN.sub("", composed(text)):
        kind = unicodedata.category(character)
        if kind == "Cf":
            continue
        kept = character.isalnum() or character in "._-" or (kind[0] == "M" and not other and result[-1:] not in ("", ".", "_", "-"))
        result += character if kept else "" if other else "-"
        other = not kept
    return composed(result)


def shortened(text: str, characters: int) -> str:
    """The beginning of ``text``: at most so many characters, and twice as many bytes in UTF-8."""
    return text[:characters].encode()[: 2 * characters].decode(errors="ignore")


def fitted(name: str) -> str:
    """``name``, or if it is too long, its beginning and six digits that stand for all of it."""
    return name if _fits(name) else f"{shortened(name, CHARACTERS - 7)}-{digest_bytes(name.encode())[:6]}"


def _fits(name: str) -> bool:
    return len(name) <= CHARACTERS and len(name.encode(errors="surrogatepass")) <= BYTES
