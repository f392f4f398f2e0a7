"""Many notes of one kind are one line."""

from voodoo_jax.records.notes import as_few


def test_many_of_one_kind_are_one_line():
    notes = [f"Feature '{k}' was not used ({k} times): no point." for k in range(20)]
    said = as_few(["First.", *notes, "Last '3'.", "First."])
    assert len(said) == 3 and said[0] == "First." and said[2] == "Last '3'."
    assert said[1].startswith(notes[0]) and "19 more: '1', '2'" in said[1] and said[1].endswith("'8' and others.")


def test_few_stay_as_they_are():
    notes = ("'/a': 3 messages left out.", "'/b': 5 messages left out.", "Something else.")
    assert as_few(notes) == notes and as_few([]) == ()
