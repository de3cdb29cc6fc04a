"""Tables from files."""

import pytest

from soft_tendon_env.tools.tables import read_table


@pytest.mark.cases("text", ["a,b\n1,2\n", "# made by us\n\na; b\n1; 2\n#\n", "a\tb\n1\t2\n\t\n"])
def test_dialects(tmp_path, text):
    path = tmp_path / "table.csv"
    path.write_text(text)
    where, header, ((row, cells),) = table = read_table(path)
    assert header == ["a", "b"] and cells == ["1", "2"] and table.numbers([("b", 0.001)]) == [[0.002]]
    line = text.splitlines().index(next(line for line in text.splitlines() if line.startswith("a"))) + 1
    assert where.startswith(f"{path}, line {line} ") and row == f"{path}, line {line + 1}"


@pytest.mark.cases("text, said", [("a,b\n1\n", "line 2: there are 1 cells"), ('a,b\n1,2\n"1,2\n', "line 3 cannot be read")])
def test_what_is_refused(tmp_path, text, said):
    (tmp_path / "table.csv").write_text(text)
    with pytest.raises(ValueError, match=said):
        read_table(tmp_path / "table.csv")
