"""How the Markdown pages read: sentences, digits, lines, links, spelling. `python tests/python/test_pages.py` lists what to mend."""

import functools
import pathlib
import re
import subprocess
import sys

import pytest
from spellchecker import SpellChecker

ROOT = pathlib.Path(__file__).resolve().parents[2]
LISTED = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.md"]
PAGES = sorted(subprocess.run(LISTED, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split())
#: Words that the dictionary lacks: terms, names, British spelling.
OURS = {word for word in (ROOT / "docs" / "words.txt").read_text().split() if not word.startswith("#")}
LONGEST_LINE = 100
LONG_SENTENCE = 28
LONG_SENTENCES_SHARE = 0.1
DIGITS_SHARE = 0.01
#: Sections that are references: figures belong there.
REFERENCES = re.compile(r"^#+ (Sources|References)$")
FENCE = re.compile(r"^\s*(```|~~~)")


def lines_outside_code(text):
    """The lines of a page with their numbers, without fenced code, what programs write between two marks, and comments."""
    for hidden in (r"<!-- (\w+)(?:: begin)? -->.*?<!-- (?:/\1|\1: end) -->", r"<!--.*?-->"):
        text = re.sub(hidden, lambda found: "\n" * found[0].count("\n"), text, flags=re.S)
    fenced = False
    for number, line in enumerate(text.splitlines(), 1):
        if FENCE.match(line):
            fenced = not fenced
        elif not fenced:
            yield number, line


def blocks(text):
    """Paragraphs, headings and list items as single lines: no code, no tables, no references."""
    block, skipped, listed = [], False, False
    for _, line in [*lines_outside_code(text), (0, "")]:
        bare = line.strip()
        heading = bare.startswith("#")
        if heading:
            skipped = REFERENCES.match(bare) is not None
        item = re.match(r"([-*+]|\d+\.) ", bare)
        indented = line.startswith("    ") and not block and not listed
        if block and (not bare or heading or item or bare.startswith("|")):
            yield " ".join(block)
            block = []
        listed = bool(item) or (listed and (not bare or line.startswith(" ")))
        if bare and not skipped and not indented and not bare.startswith("|"):
            block.append(re.sub(r"^(#+|[-*+]|\d+\.|>) ", "", bare))
            if heading:
                yield block.pop()


def prose(block):
    """A block without code, addresses and marks."""
    block = re.sub(r"`[^`]*`", "CODE", block)
    block = re.sub(r"!\[([^\]]*)\]\([^)]*\)", r"\1", block)
    block = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", block)
    block = re.sub(r"https?://\S+", "ADDRESS", block)
    # Numbers of sections.
    block = re.sub(r"§\d+|^\d+\. ", "", block)
    return re.sub(r"[*_]{1,2}(\S[^*_]*)[*_]{1,2}", r"\1", block)


def sentences(text):
    for block in blocks(text):
        for sentence in re.split(r"(?<=[.!?])[)\"”]?\s+(?=[\"“(*]?[A-ZÅÊθσ`0-9])", prose(block)):
            if sentence.strip():
                yield sentence.strip()


def words(sentence):
    return [word for word in sentence.split() if re.search(r"\w", word)]


def anchors(text):
    """The anchors of a page's headings, as code hosts make them."""
    found = set()
    for _, line in lines_outside_code(text):
        if line.startswith("#"):
            found.add(anchor(line.lstrip("# ")))
    return found


def anchor(title):
    title = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title).replace("`", "")
    return re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-")


def long_sentences(text):
    every = [(len(words(sentence)), sentence) for sentence in sentences(text)]
    return len(every), sorted((length, sentence) for length, sentence in every if length >= LONG_SENTENCE)


def digits(text):
    whole = "".join(prose(block) for block in blocks(text))
    return sum(c.isdigit() for c in whole) / max(len(whole), 1)


def long_lines(text):
    table = re.compile(r"^\s*\|")
    return [
        (number, line)
        for number, line in enumerate(text.splitlines(), 1)
        if len(line) > LONGEST_LINE and not table.match(line) and not re.match(r"^\s*(\[|<)?!?\[?\S*https?://\S+$", line)
    ]


def broken_links(page, text):
    outside = "\n".join(line for _, line in lines_outside_code(text))
    broken = []
    for target in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`\n]*`", "", outside)):
        path, _, anchor = target.partition("#")
        if re.match(r"[a-z]+:", target):
            continue
        there = (ROOT / page).parent / path if path else ROOT / page
        if not there.exists():
            broken.append(target)
        elif anchor and there.suffix == ".md" and anchor not in anchors(there.read_text(encoding="utf-8")):
            broken.append(target)
    # Pages that are named in the text, as docs/PLUGIN.md.
    for named in re.findall(r"\b(?:docs|tests|tools|crates|data|fuzz)/[\w/.-]*\w", outside):
        if not re.search(r"\.(md|py|rs|json|sh|xml|toml|bib|ipynb|cpp)$", named):
            continue
        if not (ROOT / named).exists():
            broken.append(named)
    return broken


#: Made once: it reads a large file.
dictionary = functools.cache(SpellChecker)


def misspelt(text):
    found = set()
    for block in blocks(text):
        for word in re.findall(r"[^\W\d_]+(?:['’][^\W\d_]+)?", re.sub(r"\S*[\d_/=]\S*", " ", prose(block))):
            plain = word.replace("’", "'").removesuffix("'s")
            if len(plain) > 2 and plain not in ("CODE", "ADDRESS") and not plain.isupper():
                found.add(plain)
    return sorted(word for word in dictionary().unknown(found) if word not in OURS and word.capitalize() not in OURS)


def read(page):
    return (ROOT / page).read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES)
def test_a_page_reads_well(page):
    text = read(page)
    count, long = long_sentences(text)
    assert len(long) <= max(1, LONG_SENTENCES_SHARE * count), long
    assert digits(text) <= DIGITS_SHARE, f"{digits(text):.2%} digits"
    assert not long_lines(text)
    assert not broken_links(page, text)
    assert not misspelt(text)


def test_the_checks_find_what_they_are_for():
    text = "# A `head` line\n\n" + "word\n" * 30 + ". Short one.\n\n- teh [link](nowhere.md#x) 1234\n\n```\n" + "x" * 120 + "\n```\n"
    assert [length for length, _ in long_sentences(text)[1]] == [30]
    assert long_sentences(text)[0] == 4
    assert digits(text) > DIGITS_SHARE
    assert [number for number, _ in long_lines(text)] == [38]
    assert broken_links("README.md", text) == ["nowhere.md#x"]
    assert misspelt(text) == ["teh"]
    assert anchors(text) == {"a-head-line"}


def test_no_word_is_listed_twice_or_needlessly():
    listed = (ROOT / "docs" / "words.txt").read_text().split()
    assert len(listed) == len(set(listed))
    everything = "\n".join(read(page) for page in PAGES)
    assert not [word for word in OURS if word.lower() not in everything.lower()]


def test_the_reference_of_recipes_is_that_of_the_schema():
    sys.path.insert(0, str(ROOT / "tools"))
    import recipe_page
    from built import BIN

    assert read("docs/RECIPE.md") == recipe_page.current(BIN / "bake-brdf"), "python tools/recipe_page.py > docs/RECIPE.md"


if __name__ == "__main__":
    for page in sys.argv[1:] or PAGES:
        text = read(page)
        count, long = long_sentences(text)
        print(
            f"{page}: {len(long)}/{count} long, digits {digits(text):.2%}, lines {len(long_lines(text))}, "
            f"links {broken_links(page, text)}, words {misspelt(text)}"
        )
        if len(sys.argv) > 1:
            for length, sentence in long:
                print(f"  {length}: {sentence}")
