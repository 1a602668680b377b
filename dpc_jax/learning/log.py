"""The metric log: one JSON object per line, appended, cut back when a run resumes."""

import json
import os
from pathlib import Path

from dpc_jax.files import write_text


class MetricLog:
    """`metrics.jsonl` of a run; each record has at least `step` and `seconds`."""

    def __init__(self, path: str | os.PathLike):
        self._path = Path(path)

    def write(self, record: dict):
        """Append one record; it is on disk when this returns."""
        with open(self._path, "a", encoding="utf-8") as file:
            file.write(json.dumps(record) + "\n")

    def read(self) -> list[dict]:
        """All records; a last line cut off by a kill is passed over."""
        records = []
        if self._path.exists():
            for line in self._path.read_text(encoding="utf-8").splitlines():
                try:
                    records.append(json.loads(line))
                except json.JSONDecodeError:
                    continue
        return records

    def cut_after(self, step: int):
        """Drop the records after a step: a resumed run writes them again."""
        kept = [r for r in self.read() if r["step"] <= step]
        if not self._path.exists():
            return
        write_text(self._path, "".join(json.dumps(r) + "\n" for r in kept))
