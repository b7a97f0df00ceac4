"""What was logged."""

from __future__ import annotations

from typing import Any


def logged(caplog: Any) -> str:
    """Return what was logged, without its breaks between lines."""
    return " ".join(" ".join(record.getMessage() for record in caplog.records).split())
