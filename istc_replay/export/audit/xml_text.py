"""XML as a file's bytes, and text that it can hold."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

#: Characters that XML 1.0 cannot hold.
_NOT_XML = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def xml_text(text: str) -> str:
    """Text with a question mark for each character that XML cannot hold."""
    return _NOT_XML.sub("?", text)


def as_xml(root: ET.Element) -> bytes:
    """A document's bytes."""
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"
