"""The claims of the paper are about methods and settings that the published ablation has."""

from __future__ import annotations

from visualrhp.evaluation.claims import CLAIMS, Cell
from visualrhp.evaluation.methods import KNOWN_METHODS


def cells() -> set[Cell]:
    found: set[Cell] = set()
    for comparison in (comparison for claim in CLAIMS for comparison in claim.comparisons):
        found |= {cell for cell in (comparison.one, comparison.other, *(comparison.minus or ())) if cell is not None}
    return found


def test_claims_are_about_known_methods_in_settings_of_the_suite() -> None:
    assert {cell.method for cell in cells()} <= set(KNOWN_METHODS)
    assert {cell.objects for cell in cells()} <= {"1", "7", "1-7"}
    assert {cell.noise for cell in cells()} <= {"none", "high"}
    assert {cell.size for cell in cells()} <= {"small", "mixed", "large"}


def test_no_claim_compares_a_cell_with_itself_and_none_is_made_twice() -> None:
    for claim in CLAIMS:
        assert claim.comparisons and claim.words and claim.place
        assert all(comparison.one != comparison.other for comparison in claim.comparisons)
        assert len(set(claim.comparisons)) == len(claim.comparisons)
    assert len({claim.words for claim in CLAIMS}) == len(CLAIMS)
