"""What writes into the store asks the fence, or stands here with the reason why it need not."""

import ast
from pathlib import Path

import service.store

FENCED = ("._require(", "._ours(", ".held(")
WRITING = (".writing(", ".writing_samples(", "._writing_once(")

#: A person or a command asks for it, from any process; it is no state of a machine.
ASKED_FOR = {
    "access.py": {"add_key", "revoke_key", "add_session", "end_session"},
    "alarm_overlays.py": {"change"},
    "audit.py": {"add"},
    "backup.py": {"_restore_sqlite"},
    "identity.py": {"confirm"},
    "impossible_times.py": {"_remove"},
    "nights/results.py": {"keep"},
    "nights/tables.py": {"save"},
    "provisioned_assets.py": {"change"},
    "refused_changes.py": {"add", "repeat"},
    "runs/runs.py": {"_write", "rename", "annotate", "remove_annotation"},
    "silences/tables.py": {"add", "end"},
}
#: What was measured is a fact: the same from whichever process, stored once for channel and time.
FACTS = {"samples.py": {"write"}}
#: Two at a time do no harm: each step is a transaction that looks before it writes.
UPKEEP = {
    "alarm_journal.py": {"expire"},
    "ledger/tables.py": {"due", "settle"},
    "packing.py": {"pack"},
    "part.py": {"_expire", "_writing_once"},
    "refused_changes.py": {"expire"},
    "rollups.py": {
        "refresh",
        "retention_time",
        "confirm_clock",
        "lower_raw_horizon",
        "expire_at",
        "pack_rows",
        "_expire_raw",
    },
}
#: Writes nothing of its own: the parts that write within it ask the fence.
JOINED = {"database.py": {"together"}}
#: Done where there is one cell only.
ALONE = {"silences/tables.py": {"change"}}
#: Files on the disk of one process.
OWN_FILES = {"durable_queue.py": {"append", "remove", "discard"}}


def test_no_way_of_writing_is_without_a_fence_but_those_that_need_none() -> None:
    known = {
        (file, name)
        for group in (ASKED_FOR, FACTS, UPKEEP, JOINED, ALONE, OWN_FILES)
        for file, names in group.items()
        for name in names
    }
    found = set()
    store = Path(service.store.__file__).parent
    features = store.parent / "features"
    files = {path.name: path for path in store.glob("*.py")}
    files |= {str(path.relative_to(features)): path for path in features.rglob("*.py")}
    for file, path in files.items():
        text = path.read_text()
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef):
                body = ast.get_source_segment(text, node) or ""
                writes = any(one in body for one in WRITING)
                if writes and not any(one in body for one in FENCED):
                    found.add((file, node.name))
    assert found == known
