"""Rows that wait on the disk until their object is complete, so that memory holds a block of them.

The rows of a scene go to a file of their own: a scene that fails half-way leaves none.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path

import pyarrow as pa
import pyarrow.ipc


class Spool:
    """A file of rows, written block by block."""

    def __init__(self, path: Path, rows: pa.Schema) -> None:
        self.path = path
        self.count = 0  # rows written
        self._stream = pa.ipc.new_stream(path, rows)

    def write(self, table: pa.Table) -> None:
        """Add rows."""
        self._stream.write_table(table)
        self.count += len(table)

    def close(self) -> None:
        """Nothing is added after this."""
        self._stream.close()

    def discard(self) -> None:
        """Remove the file."""
        self._stream.close()
        self.path.unlink(missing_ok=True)


def drained(spools: Iterable[Spool], rows: pa.Schema, *, size: int) -> Iterator[pa.Table]:
    """The rows of all spools in tables of exactly `size` rows, and what is left.

    Args:
        spools: Closed ones; each is removed when it has been read.
        rows: Their schema.
        size: Rows of a table, however the blocks were cut.
    """
    held = rows.empty_table()
    for spool in spools:
        with pa.ipc.open_stream(pa.OSFile(str(spool.path))) as blocks:
            for block in blocks:
                held = pa.concat_tables([held, pa.Table.from_batches([block])])
                while held.num_rows >= size:
                    yield held.slice(0, size).combine_chunks()
                    held = held.slice(size)
        spool.discard()
    if held.num_rows:
        yield held.combine_chunks()
