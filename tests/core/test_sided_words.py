"""Words that name a side: lexicons, and what a segment says of a mirrored dancer."""

from dataclasses import replace
from fractions import Fraction

import pytest

from dancedata.core.segments import CLIP_END, Layer, Segment
from dancedata.core.sided_words import ENGLISH, Lexicon, lexicon_of, mirrored_segment, with_mirrored_words

WORDS = Layer("description", language="en")
GERMAN = Lexicon("de", (("links", "rechts"), ("linke", "rechte"), ("linker", "rechter")))
CHINESE = Lexicon("zh", (("左", "右"),), whole_words=False)


def segment(*texts: str, layer: Layer = WORDS, **more: object) -> Segment:
    return Segment(layer, Fraction(0), Fraction(1), texts=texts, **more)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "mirrored"),
    [
        ("Steps Left, then LEFT", "Steps Right, then RIGHT"),
        ("a left-handed wave to stage left", "a right-handed wave to stage right"),
        ("spins counter-clockwise, then clockwise", "spins clockwise, then counterclockwise"),
        ("goes anti clockwise", "goes clockwise"),
        ("lifts the L foot and the RH", "lifts the R foot and the LH"),
        ("right away turns right", "right away turns left"),
        ("LeftKick then kickRIGHT", "RightKick then kickLEFT"),
        ("TURN_LEFT", "TURN_RIGHT"),
        ("step_L, L2, LKick, kickL", "step_R, R2, RKick, kickR"),
        ("l_arm hand.l lArm, r-leg", "r_arm hand.r rArm, l-leg"),
        ("turns CW, then ccw, TurnCW", "turns CCW, then cw, TurnCCW"),
        ("Counter_clockwise, AntiClockwise", "Clockwise, Clockwise"),
        ("counter  clockwise", "clockwise"),
        ("from 3 o'clock to 10 o'clock", "from 9 o'clock to 2 o'clock"),
        ("lefts and rights", "rights and lefts"),
        ("the dancer's left, bright", "the dancer's right, bright"),
        ("cross left over right, right behind left", "cross right over left, left behind right"),
        (
            "right in front of the left foot, left off the floor",
            "left in front of the right foot, right off the floor",
        ),
        ("is left-handed, at nine o'clock", "is right-handed, at three o'clock"),
        ("9 o\N{RIGHT SINGLE QUOTATION MARK}clock, rt foot", "3 o\N{RIGHT SINGLE QUOTATION MARK}clock, lt foot"),
    ],
)
def test_words_are_exchanged(text: str, mirrored: str) -> None:
    assert ENGLISH.names_side(text)
    assert ENGLISH.mirrored(text) == mirrored


@pytest.mark.parametrize(
    "text",
    ["upright", "he left the stage right away", "R&B", "a right angle", "the lift", "l", "l. and r.", "r.n.b",
     "bright", "all  right", "he has nothing left", "is left, stands right behind her",
     "Brightly frightened, a leftover", "XL, ULTRA, Rn", "a l'air",
     "LaFAN, McLeod", "clock", "\u5411\u5de6\u8f6c"],
)  # fmt: skip
def test_words_that_name_no_side(text: str) -> None:
    assert not ENGLISH.names_side(text)
    assert ENGLISH.mirrored(text) == text
    assert not ENGLISH.unread(text)
    assert sided(segment(text))[0].layer.sided == "no"


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("leftkick", "leftkick"), ("a kickright, LEFTTURN", "kickright"), ("turn left, then a turnleft", "turnleft"),
        ("LeFt", "LeFt"), ("clockwiseturn", "clockwiseturn"), ("rightsize, copyrightleft", "rightsize"),
    ],
)  # fmt: skip
def test_a_side_inside_of_a_word_is_never_no_side(text: str, word: str) -> None:
    """Such a layer is unknown, whatever else it says, unless the author says what its words become."""
    assert ENGLISH.unread(text) == word
    for sides in ("unknown", "mirrored"):
        layer = replace(WORDS, sided=sides)
        for found in sided(segment("jumps", layer=layer), segment(text, layer=layer)):
            assert found.layer.sided == "unknown"
            assert not found.texts_mirrored
    labels = sided(segment(label="turn left"), segment(label=text))
    assert {s.layer.sided for s in labels} == {"unknown"}
    (stated,) = sided(segment(text, texts_mirrored=("said",)))
    assert stated.layer.sided == "mirrored"
    pair = replace(WORDS, mirror=((text, "its mirror"),))
    assert sided(segment(label=text, layer=pair))[0].layer.sided == "mirrored"
    assert sided(segment(text, layer=replace(WORDS, sided="no")))[0].layer.sided == "no"


def test_own_lexicons_have_the_same_borders() -> None:
    german = Lexicon("de", (("links", "rechts"), ("linkes", "rechtes")), same=("rechtsstaat",))
    assert german.mirrored("Drehung_links, LinksDrehung") == "Drehung_rechts, RechtsDrehung"
    assert german.unread("Rechtsdrehung") == "Rechtsdrehung"
    assert german.unread("linksherum") == "linksherum"
    assert not german.unread("rechtsstaat, Recht")
    assert not CHINESE.unread("\u5411\u5de6\u8f6c")


def test_scripts_without_spaces_and_varieties_of_a_language() -> None:
    assert CHINESE.mirrored("向左转") == "向右转"
    assert lexicon_of("en-GB", [GERMAN, ENGLISH]) is ENGLISH
    assert lexicon_of("english", [ENGLISH]) is None
    assert lexicon_of("", [ENGLISH]) is None


def sided(*segments: Segment, lexicons: tuple[Lexicon, ...] = (ENGLISH,)) -> list[Segment]:
    return [s for (s,) in with_mirrored_words([[s] for s in segments], lexicons)]


def test_a_layer_finds_out_whether_it_names_sides() -> None:
    plain = sided(segment("jumps"), segment("waves", "greets"))
    assert {s.layer.sided for s in plain} == {"no"}
    named = sided(segment("jumps"), segment("turns left", "spins"), segment("x", label="left turn"))
    assert {s.layer.sided for s in named} == {"mirrored"}
    assert [s.texts_mirrored for s in named] == [("jumps",), ("turns right", "spins"), ("x",)]
    assert named[0].layer.mirror == (("left turn", "right turn"),)


def test_words_of_a_language_without_a_lexicon_are_never_assumed_to_be_the_same() -> None:
    german = replace(WORDS, language="de")
    (unknown,) = sided(segment("nach links", layer=german))
    assert not unknown.can_be_mirrored
    (claimed,) = sided(segment("nach links", layer=replace(german, sided="mirrored")))
    assert not claimed.can_be_mirrored
    (stated,) = sided(segment("nach links", layer=german, texts_mirrored=("nach rechts",)))
    assert stated.layer.sided == "mirrored"
    (made,) = sided(segment("nach links", layer=german), lexicons=(ENGLISH, GERMAN))
    assert made.texts_mirrored == ("nach rechts",)
    (no,) = sided(segment("nach links", layer=replace(german, sided="no")))
    assert no.can_be_mirrored
    (labels,) = sided(segment(layer=Layer("moves"), label="spin"))
    assert labels.layer.sided == "unknown"
    (numbers,) = sided(segment(layer=Layer("marks")))
    assert numbers.layer.sided == "no"


def test_label_words_tokens_and_joint_of_a_mirrored_dancer() -> None:
    tokens = ("right/ADV away/ADV step/VERB right/ADJ leg/NOUN", "spin/VERB counter/ADJ clockwise/ADJ", "jump/VERB")
    texts = "right away steps with the right leg", "spins counter clockwise", "jumps"
    (made,) = sided(segment(*texts, tokens=tokens, label="left turn", joint=4))
    mirrored = mirrored_segment(made, {4: 5, 5: 4})
    assert (mirrored.label, mirrored.joint) == ("right turn", 5)
    assert mirrored.texts == ("right away steps with the left leg", "spins clockwise", "jumps")
    assert mirrored.texts_mirrored == texts
    assert mirrored.tokens == ("right/ADV away/ADV step/VERB left/ADJ leg/NOUN", "", "jump/VERB")


def test_the_end_of_a_clip() -> None:
    whole = Segment(WORDS, Fraction(0), CLIP_END)
    assert whole.within(Fraction(5, 2)).end == Fraction(5, 2)
    assert segment("x").within(Fraction(5, 2)).end == 1
