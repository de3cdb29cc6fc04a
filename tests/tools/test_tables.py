"""Tables from files."""

from soft_tendon_env.tools.files import MOST_TEXT
from soft_tendon_env.tools.tables import read_table


def test_tables_may_be_longer_than_other_texts(tmp_path):
    """As the log of a run of minutes is."""
    path, cell = tmp_path / "long.csv", "0" * 100_000
    count = MOST_TEXT // len(cell) + 1
    path.write_text("time\n" + f"{cell}\n" * count)
    where, header, rows, _ = read_table(path)
    assert (where, header) == (f"{path}, line 1", ["time"]) and len(rows) == count and rows[-1] == (f"{path}, line {count + 1}", [cell])
