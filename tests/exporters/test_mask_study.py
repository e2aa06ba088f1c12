"""The study of what masks are worth, on one house."""

from __future__ import annotations

from exporters import mask_study


def test_true_masks_lift_what_stands_behind_other_things(capsys):
    assert mask_study.main(["--houses", "1", "--first", "2", "--views", "40"]) == 0
    told, _, *rows = capsys.readouterr().out.splitlines()
    assert told.startswith("1 houses; grabcut: ")
    table = {tuple(row.split()[:3]): row.split()[3:] for row in rows}
    assert len(table) == 2 * 2 * len(mask_study.ARMS)
    for kind in ("hidden", "plain"):
        for context in ("all", "none"):
            without, true = (float(table[kind, context, arm][4]) for arm in ("none", "truth"))
            assert true <= without
            assert true < 1.0
            assert int(table[kind, context, "truth"][0]) > 0


def test_a_file_that_is_not_there_is_told(tmp_path, capsys):
    assert mask_study.main([str(tmp_path / "none.jsonl")]) == 1
    assert "none.jsonl: No such file" in capsys.readouterr().err
