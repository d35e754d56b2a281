"""The account of the fleet's demo as tables for people."""

from rich.console import Console
from rich.table import Table

from bearing_twin_laboratory.fleet_demo.story import Account


def print_account(account: Account, console: Console) -> None:
    """Print what was done and seen, and the ledger."""
    acts = Table(title="What was done, and wall seconds until all was well")
    for heading in ("", "all owned again", "fresh values", "polls skipped"):
        acts.add_column(heading, justify="right" if heading else "left")
    for act in account.acts:
        owned = "kept" if act.owned_s is None else f"{act.owned_s:.1f}"
        acts.add_row(act.what, owned, f"{act.fresh_s:.1f}", str(act.polls_skipped))
    console.print(acts)
    count, answers = account.count, account.answers
    wrong = [*account.wrong_answers, *account.wrong_messages, *account.alarms_disagree]
    ledger = Table(title="The ledger outside", show_header=False)
    ledger.add_column()
    ledger.add_column(justify="right")
    for name, value in (
        ("samples acknowledged", f"{count.acknowledged:,}"),
        ("stored", f"{count.stored:,}"),
        ("missing", str(count.missing)),
        ("stored twice", str(count.stored_twice)),
        ("out of order", str(count.out_of_order)),
        ("pushes repeated at the other web process", str(account.pushes_repeated)),
        ("longest time without an owner", f"{account.longest_without_owner_s:.1f} s"),
        ("stale writes refused", str(account.stale_writes_refused)),
        ("stale writes accepted", str(account.stale_writes_accepted)),
        ("open alarms that store and owners disagree on", str(len(account.alarms_disagree))),
        ("changes refused, and kept in a list", str(account.changes_refused)),
        ("alarms raised again", str(account.alarms_raised_again)),
        ("polls skipped", str(account.polls_skipped)),
        ("answers fresh", str(answers["fresh"])),
        ("answers marked as old", str(answers["marked_old"])),
        ("answers 'try again'", str(answers["try_again"])),
        ("answers wrong", str(len(account.wrong_answers) + len(account.wrong_messages))),
    ):
        ledger.add_row(name, value)
    console.print(ledger)
    for one in wrong[:10]:
        console.print(f"Wrong: {one}", soft_wrap=True, markup=False)
    console.print("Nothing is lost." if account.is_clean else "The ledger is not clean.")
