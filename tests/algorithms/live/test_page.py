"""The page of a live session, in a browser: every state, every key, and what it does when things go wrong."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from moral_envs import delivery_v0, emergency_v0
from moral_envs.world import World
from tests.algorithms.live import scenes
from tests.algorithms.live.browser import LAPTOP, PHONE, browser_or_skip
from tests.algorithms.live.stand_in import StandIn, serving

KEYS = {0: "ArrowUp", 1: "ArrowDown", 2: "ArrowLeft", 3: "ArrowRight", 4: " ", 5: "w", 6: "s", 7: "a", 8: "d"}
DRAWN = "window.moral.drawn()"

# What the browser says of replies that the tests spoil on purpose.
_SPOILT = "Failed to load resource"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with browser_or_skip() as running:
        yield running


@pytest.fixture
def visit(browser: Any) -> Iterator[Callable[..., Any]]:
    """Open pages; at the end, none of them may have complained or asked for anything from elsewhere."""
    contexts, complaints, foreign = [], [], []

    def open_page(url: str, **options: Any) -> Any:
        context = browser.new_context(**{"viewport": LAPTOP, "reduced_motion": "reduce", **options})
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(10_000)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", lambda message: message.type == "error" and complaints.append(message.text))
        page.on("request", lambda request: foreign.append(request.url))
        page.goto(url)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert [text for text in complaints if _SPOILT not in text] == []
    assert [url for url in foreign if not url.startswith(("http://127.0.0.1:", "data:"))] == []


@contextmanager
def opened(visit: Callable[..., Any], scene: StandIn, state: str, **options: Any) -> Iterator[Any]:
    with serving(scene) as url:
        page = visit(url, **options)
        wait_for(page, state)
        yield page


def wait_for(page: Any, state: str) -> None:
    page.wait_for_function("state => document.body.dataset.state === state", arg=state)


def wait_for_query(page: Any, query: int) -> None:
    page.wait_for_function(
        f"number => document.body.dataset.state === 'question' && {DRAWN}.query === number", arg=query
    )


def wait_until(page: Any, condition: Callable[[], bool]) -> None:
    """Wait, while the page goes on, for something that happens in this process."""
    for _ in range(500):
        if condition():
            return
        page.wait_for_timeout(20)
    raise AssertionError("it did not happen within ten seconds")


def step_through(page: Any) -> Iterator[dict[str, Any]]:
    """What is drawn at each whole step from the start, by the keyboard."""
    page.keyboard.press("Home")
    steps = int(page.get_attribute("#scrub", "max"))
    for step in range(steps + 1):
        drawn = page.evaluate(DRAWN)
        assert drawn["left"]["moment"] == step
        yield drawn
        page.keyboard.press(".")


def things(drawn: dict[str, Any], pattern: str) -> set[tuple[float, float]]:
    return {(thing["row"], thing["column"]) for thing in drawn["things"] if thing["pattern"] == pattern}


# ---- States ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scene", "state", "text", "asks"),
    [
        (scenes.preparing, "preparing", "Getting ready", True),
        (scenes.waiting, "waiting", "The next question is on its way", True),
        (scenes.emergency, "question", "Which of these two went better?", True),
        (scenes.consent, "consent", scenes.NOTICE, True),
        (scenes.enough, "question", "More answers would change little now.", True),
        (scenes.closing, "closing", "You answered 25 questions.", False),
        (scenes.finished, "finished", "people saved 6.0", False),
        (scenes.halted, "halted", "Training has stopped", False),
    ],
)
def test_every_state_says_what_it_is_on_one_screen(
    visit: Callable[..., Any], scene: Callable[[], StandIn], state: str, text: str, asks: bool
) -> None:
    with opened(visit, scene(), state) as page:
        # Nothing is said of a next answer where none comes.
        assert page.is_visible("#teach") is asks
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            assert text in " ".join(page.inner_text("main").split())
            width, height = page.evaluate(
                "[document.documentElement.scrollWidth, document.documentElement.scrollHeight]"
            )
            assert (width, height) == (LAPTOP["width"], LAPTOP["height"])


@pytest.mark.parametrize("scene", [scenes.emergency, scenes.delivery, scenes.waiting, scenes.consent])
def test_a_phone_shows_one_column_without_scrolling_sideways(
    visit: Callable[..., Any], scene: Callable[[], StandIn]
) -> None:
    with serving(scene()) as url:
        page = visit(url, viewport=PHONE, is_mobile=True, has_touch=True)
        page.wait_for_function("() => document.body.dataset.state !== 'connecting'")
        assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
        if page.evaluate("document.body.dataset.state") == "question":
            box = page.locator("[data-answer=unsure]").bounding_box()
            assert box["y"] + box["height"] <= PHONE["height"]


def test_a_notice_comes_before_the_first_question(visit: Callable[..., Any]) -> None:
    scene = scenes.consent()
    with opened(visit, scene, "consent") as page:
        assert page.evaluate(DRAWN)["left"] is None
        page.keyboard.press("Enter")
        wait_for(page, "question")
    assert scene.state["consent"]["given"]


def test_the_page_follows_the_training(visit: Callable[..., Any]) -> None:
    scene = scenes.preparing()
    with opened(visit, scene, "preparing") as page:
        after = scenes.emergency().state
        scene.change(status=after["status"], queue=after["queue"], curves=after["curves"])
        wait_for(page, "question")
        page.wait_for_selector("#posterior svg.density")
        assert page.inner_text("#answered") == "12"
        # What is asked last is left to be answered when training closes.
        scene.change(status={**after["status"], "phase": "closing"}, queue={**after["queue"], "open": []})
        wait_for(page, "question")
        page.keyboard.press("ArrowLeft")
        wait_for(page, "closing")
        scene.change(status={**after["status"], "phase": "finished", "objectives": [50.0, 6.0]})
        wait_for(page, "finished")
        assert page.is_disabled("#undo")


@pytest.mark.parametrize(
    ("scene", "drawing", "words"),
    [
        (scenes.emergency, "density", ["extinguish", "saving"]),
        (scenes.delivery, "triangle", ["deliver", "helping", "cleaning"]),
        (scenes.four_norms, "intervals", ["deliver", "helping", "cleaning", "sparing"]),
    ],
)
def test_the_posterior_is_drawn_for_any_number_of_weights(
    visit: Callable[..., Any], scene: Callable[[], StandIn], drawing: str, words: list[str]
) -> None:
    stand_in = scene()
    with opened(visit, stand_in, "question") as page:
        page.wait_for_selector(f"#posterior svg.{drawing}")
        text = page.get_attribute("#posterior", "aria-label")
        shares = [round(100 * weight) for weight in stand_in.state["status"]["weights"]]
        for word, share in zip(words, shares, strict=True):
            assert f"{word} {share} %" in text
        assert page.locator("#posterior .sample").count() == (200 if drawing == "triangle" else 0)


def test_components_have_the_names_that_people_read(visit: Callable[..., Any]) -> None:
    stand_in = scenes.emergency(components=["extinguish", "learned_1"])
    stand_in.state["names"] = {"extinguish": "fighting the fire", "learned_1": "the expert"}
    with opened(visit, stand_in, "question") as page:
        page.wait_for_selector("#posterior svg")
        assert "fighting the fire" in page.inner_text("#posterior")
        assert "the expert" in page.inner_text("#posterior")
        assert "learned" not in page.inner_text("body")


@pytest.mark.parametrize("scene", [scenes.emergency, scenes.delivery, scenes.four_norms])
def test_the_longest_names_fit_into_the_charts(
    visit: Callable[..., Any], scene: Callable[[], StandIn]
) -> None:
    stand_in = scene()
    components = stand_in.state["status"]["components"]
    stand_in.state["names"] = {name: f"a name of {len(components)} words"[:18] for name in components}
    with opened(visit, stand_in, "question") as page:
        for viewport in (LAPTOP, PHONE):
            page.set_viewport_size(viewport)
            page.wait_for_selector("#posterior svg text")
            require_texts_apart(page)


def require_texts_apart(page: Any) -> None:
    """In the chart of the weights none leaves it, and none stands on another."""
    (start, end, _, _), *texts = page.evaluate(
        """() => [...document.querySelectorAll("#posterior, #posterior text")].map((element) => {
            const { left, right, top, bottom } = element.getBoundingClientRect();
            return [left, right, top, bottom];
        })"""
    )
    for number, (left, right, top, bottom) in enumerate(texts):
        assert start - 1 <= left < right <= end + 1
        for other_left, other_right, other_top, other_bottom in texts[:number]:
            apart = left >= other_right or right <= other_left or top >= other_bottom or bottom <= other_top
            assert apart


# ---- What is drawn -----------------------------------------------------------------------------------------


def walking() -> StandIn:
    """Emergency, but in each episode a person takes two steps."""
    stand_in = scenes.emergency()
    for episode in stand_in.queries[17]:
        (row, column), kind = episode["things"][0]["cell"], episode["things"][0]["kind"]
        episode["things"][0]["gone"] = 2
        for offset, since, gone in ((1, 2, 4), (2, 4, None)):
            there = {"kind": kind, "cell": [row, column + offset], "from": since, "gone": gone}
            episode["things"].append(there)
    return stand_in


@pytest.mark.parametrize("scene", [scenes.emergency, scenes.delivery, walking])
def test_what_is_drawn_is_what_happened(visit: Callable[..., Any], scene: Callable[[], StandIn]) -> None:
    stand_in = scene()
    patterns = {kind["name"]: kind["pattern"] for kind in stand_in.state["world"]["kinds"]}
    with opened(visit, stand_in, "question") as page:
        for step, drawn in enumerate(step_through(page)):
            for side, episode in zip(("left", "right"), stand_in.queries[17], strict=True):
                assert things(drawn[side], "agent") == {tuple(episode["agent"][step])}
                for name, pattern in patterns.items():
                    there = {
                        tuple(thing["cell"])
                        for thing in episode["things"]
                        if thing["kind"] == name
                        and thing.get("from", 0) <= step
                        and (thing["gone"] is None or thing["gone"] > step)
                    }
                    assert things(drawn[side], pattern) == there


def test_the_lanes_mark_every_event(visit: Callable[..., Any]) -> None:
    stand_in = scenes.delivery()
    with opened(visit, stand_in, "question") as page:
        for side, episode in zip(("left", "right"), stand_in.queries[17], strict=True):
            marks = page.eval_on_selector_all(
                f".lane.{side} .mark", "marks => marks.map(({dataset}) => [dataset.objective, +dataset.from])"
            )
            expected = [[event["objective"], event["step"]] for event in episode["events"]]
            assert sorted(marks) == sorted(expected)


def test_saving_somebody_from_the_extinguisher_s_cell_is_two_events(visit: Callable[..., Any]) -> None:
    stand_in = scenes.emergency()
    left = stand_in.queries[17][0]
    step = next(event["step"] for event in left["events"]) + 1
    neighbour = [left["fixture"][0] - 1, left["fixture"][1]]
    left["things"].append({"kind": "people", "cell": neighbour, "gone": step})
    left["events"].append({"step": step, "objective": "people_saved", "cell": neighbour})
    with opened(visit, stand_in, "question") as page:
        marks = page.eval_on_selector_all(
            ".lane.left .mark", "marks => marks.map(({dataset}) => [dataset.objective, dataset.from])"
        )
        assert sorted(marks) == [["goal_time", str(step - 1)], ["people_saved", str(step)]]


def test_time_at_the_extinguisher_is_one_bar(visit: Callable[..., Any]) -> None:
    stand_in = scenes.emergency()
    with opened(visit, stand_in, "question") as page:
        for side, episode in zip(("left", "right"), stand_in.queries[17], strict=True):
            steps = [event["step"] for event in episode["events"] if event["objective"] == "goal_time"]
            runs = page.eval_on_selector_all(
                f".lane.{side} .mark.run", "marks => marks.map(({dataset}) => [+dataset.from, +dataset.to])"
            )
            assert [step for first, last in runs for step in range(first, last + 1)] == steps


def test_the_canvas_holds_the_picture(visit: Callable[..., Any]) -> None:
    """The robot's blue is where the page says that it drew the agent, and not where it was before."""
    look = """([row, column]) => {
        const canvas = document.querySelector("#left canvas");
        const tile = canvas.width / (8 - 2 + 0.9);
        const at = (cell) => Math.round((cell - 0.55 + 0.5) * tile);
        const belly = at(row) + Math.round(0.3 * tile);
        return [...canvas.getContext("2d").getImageData(at(column), belly, 1, 1).data];
    }"""
    with opened(visit, scenes.emergency(), "question") as page:
        page.keyboard.press("Home")
        ((row, column),) = things(page.evaluate(DRAWN)["left"], "agent")
        blue = [0, 114, 178, 255]
        assert page.evaluate(look, [row, column]) == blue
        for _ in range(6):
            page.keyboard.press(".")
        assert page.evaluate(look, [row, column]) != blue


def test_counts_are_hidden_until_they_are_wanted(visit: Callable[..., Any]) -> None:
    stand_in = scenes.emergency()
    with opened(visit, stand_in, "question") as page:
        assert not page.is_visible("#left .counts")
        page.keyboard.press("End")
        page.keyboard.press("c")
        goal_time, saved = stand_in.queries[17][1]["counters"][-1]
        assert page.inner_text("#right .counts") == f"goal time {goal_time} · people saved {saved}"
        page.keyboard.press("Home")
        assert page.inner_text("#right .counts") == "goal time 0 · people saved 0"
        page.keyboard.press("c")
        assert not page.is_visible("#left .counts")


def test_the_player_plays_pauses_and_changes_speed(visit: Callable[..., Any]) -> None:
    with opened(visit, scenes.emergency(), "question", reduced_motion="no-preference") as page:
        page.wait_for_function(f"() => {DRAWN}.playing && {DRAWN}.left.moment > 0.1")
        page.keyboard.press("Space")
        drawn = page.evaluate(DRAWN)
        assert not drawn["playing"]
        assert drawn["left"]["moment"] == drawn["right"]["moment"]
        for speed in ("2\N{MULTIPLICATION SIGN}", "4\N{MULTIPLICATION SIGN}"):
            page.keyboard.press("s")
            assert page.inner_text("#speed") == speed
        page.keyboard.press("Space")
        page.wait_for_function(f"() => {DRAWN}.left.moment === 75 && !{DRAWN}.playing", timeout=30_000)
        assert page.get_attribute("#play", "aria-label") == "Play again"
        page.click("#play")
        page.wait_for_function(f"() => {DRAWN}.left.moment < 60 && {DRAWN}.playing")


def test_the_mouse_scrubs(visit: Callable[..., Any]) -> None:
    with opened(visit, scenes.emergency(), "question") as page:
        box = page.locator("#scrub").bounding_box()
        page.mouse.click(box["x"] + box["width"] * 0.4, box["y"] + box["height"] / 2)
        drawn = page.evaluate(DRAWN)
        assert not drawn["playing"]
        assert drawn["left"]["moment"] == pytest.approx(30, abs=0.5)


def test_less_motion_shows_whole_steps_and_plays_nothing_by_itself(visit: Callable[..., Any]) -> None:
    with opened(visit, scenes.emergency(), "question") as page:
        drawn = page.evaluate(DRAWN)
        assert (drawn["playing"], drawn["left"]["moment"]) == (False, 75)
        page.keyboard.press("Home")
        page.evaluate("scrub = document.querySelector('#scrub'); scrub.value = 1.6")
        page.dispatch_event("#scrub", "input")
        ((row, column),) = things(page.evaluate(DRAWN)["left"], "agent")
        assert (row, column) == (round(row), round(column))


# ---- Answers -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "selector", "preference"),
    [
        ("ArrowLeft", "[data-answer=left]", "first"),
        ("2", "[data-answer=right]", "second"),
        ("ArrowDown", "[data-answer=equal]", "equal"),
        ("x", "[data-answer=unsure]", "cannot_tell"),
    ],
)
def test_a_key_and_a_click_say_the_same(
    visit: Callable[..., Any], key: str, selector: str, preference: str
) -> None:
    stand_in = scenes.emergency()
    with opened(visit, stand_in, "question") as page:
        page.keyboard.press(key)
        page.wait_for_function(
            """selector => document.body.dataset.state === "answered"
                && document.querySelector(selector).hasAttribute("data-chosen")""",
            arg=selector,
        )
        wait_for_query(page, 18)
        page.click(selector)
        wait_for_query(page, 19)
        assert page.evaluate("performance.getEntriesByName('moral: answer recorded').length") == 2
        page.wait_for_function("() => document.querySelector('#answered').textContent === '14'")
    assert [(query, body["preference"]) for query, body in stand_in.answers] == [
        (17, preference),
        (18, preference),
    ]
    assert all(0 <= body["seconds"] < 60 for _, body in stand_in.answers)


def test_pressing_twice_or_holding_a_key_counts_once(visit: Callable[..., Any]) -> None:
    stand_in = scenes.emergency()
    with opened(visit, stand_in, "question") as page:
        # At once, however busy the machine is.
        page.evaluate(
            """() => ["ArrowLeft", "ArrowLeft"].forEach((key) =>
                document.body.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true })))"""
        )
        wait_for_query(page, 18)
        page.eval_on_selector("[data-answer=right]", "button => { button.click(); button.click(); }")
        wait_for_query(page, 19)
        page.keyboard.down("ArrowRight")
        for _ in range(5):
            page.keyboard.down("ArrowRight")
        wait_for_query(page, 20)
        page.keyboard.down("ArrowRight")
        page.keyboard.up("ArrowRight")
    assert [query for query, _ in stand_in.answers] == [17, 18, 19]


def test_undo_shows_the_question_again(visit: Callable[..., Any]) -> None:
    stand_in = scenes.emergency()
    with opened(visit, stand_in, "question") as page:
        page.keyboard.press("ArrowLeft")
        wait_for(page, "answered")
        page.keyboard.press("u")
        wait_for_query(page, 17)
        # The page shows the question a moment before it says so.
        page.locator("#notice", has_text="taken back").wait_for()
        page.keyboard.press("ArrowRight")
        wait_for_query(page, 18)
        page.click("#undo")
        wait_for_query(page, 17)
        # Further back than this page was open.
        page.keyboard.press("u")
        wait_for_query(page, 16)
        page.keyboard.press("ArrowDown")
        wait_for_query(page, 17)
    assert stand_in.undone == [17, 17, 16]
    assert [(query, body["preference"]) for query, body in stand_in.answers] == [
        (17, "first"),
        (17, "second"),
        (16, "equal"),
    ]


def test_an_answer_whose_acknowledgement_was_lost_is_sent_again_and_counts_once(
    visit: Callable[..., Any],
) -> None:
    stand_in = scenes.emergency()
    with opened(visit, stand_in, "question") as page:
        stand_in.lose_reply = True
        page.keyboard.press("ArrowLeft")
        wait_for_query(page, 18)
        page.wait_for_function("() => document.querySelector('#answered').textContent === '13'")
    assert [query for query, _ in stand_in.answers] == [17]


def test_a_reply_that_an_event_has_overtaken_hides_no_question(visit: Callable[..., Any]) -> None:
    stand_in = scenes.emergency()
    with opened(visit, stand_in, "question") as page:
        # Nothing else is open when the answer arrives; what opens then is told before the answer's reply.
        opened_later = stand_in.state["queue"]["open"][1:]
        stand_in.change(queue={**stand_in.state["queue"], "open": stand_in.state["queue"]["open"][:1]})
        stand_in.late_reply = threading.Event()
        page.keyboard.press("ArrowLeft")
        wait_until(page, lambda: bool(stand_in.answers))
        stand_in.change(queue={**stand_in.state["queue"], "open": opened_later, "queries": 24})
        page.wait_for_function("() => document.querySelector('#of').textContent === ' of 24'")
        stand_in.late_reply.set()
        wait_for_query(page, 18)


def test_an_answer_given_while_the_server_is_away_is_kept(visit: Callable[..., Any]) -> None:
    stand_in = scenes.emergency()
    with opened(visit, stand_in, "question") as page:
        # The stream still stands: the page learns of it by the answer.
        stand_in.down = True
        page.keyboard.press("ArrowRight")
        wait_for(page, "sending")
        stand_in.hang_up(down=True)
        wait_for(page, "disconnected")
        stand_in.down = False
        wait_for_query(page, 18)
    assert [(query, body["preference"]) for query, body in stand_in.answers] == [(17, "second")]


def test_the_page_reconnects_by_itself_and_shows_the_same_question(visit: Callable[..., Any]) -> None:
    stand_in = scenes.emergency()
    with opened(visit, stand_in, "question") as page:
        page.keyboard.press("End")
        stand_in.hang_up(down=True)
        wait_for(page, "disconnected")
        assert "reconnects by itself" in page.inner_text("#notice")
        page.keyboard.press("ArrowLeft")
        stand_in.down = False
        wait_for_query(page, 17)
        assert page.evaluate(DRAWN)["left"]["moment"] == 75
        assert page.inner_text("#notice") == ""
        page.keyboard.press("ArrowLeft")
        wait_for_query(page, 18)
    assert [query for query, _ in stand_in.answers] == [17]


def test_a_page_of_another_session_says_that_it_has_ended(visit: Callable[..., Any]) -> None:
    stand_in = scenes.emergency()
    with opened(visit, stand_in, "question") as page:
        stand_in.foreign = True
        stand_in.hang_up(down=False)
        wait_for(page, "ended")
        assert "This session has ended" in page.inner_text("#message")
        assert page.inner_text("#connection").strip() == "Ended"


def test_two_windows_answer_a_question_once(visit: Callable[..., Any]) -> None:
    stand_in = scenes.emergency()
    with serving(stand_in) as url:
        one, other = visit(url), visit(url)
        wait_for_query(one, 17)
        wait_for_query(other, 17)
        one.keyboard.press("ArrowLeft")
        wait_for_query(one, 18)
        wait_for_query(other, 18)
        assert "answered in another window" in other.inner_text("#notice")
    assert [query for query, _ in stand_in.answers] == [17]


def test_an_answer_that_comes_second_is_not_counted(visit: Callable[..., Any]) -> None:
    stand_in = scenes.emergency()
    with opened(visit, stand_in, "question") as page:
        stand_in.standing[17] = "first"
        page.keyboard.press("ArrowRight")
        page.wait_for_function(
            "() => document.querySelector('#notice').textContent.includes('another window')"
        )
    assert stand_in.answers == []


def test_a_retired_question_stays_and_counts(visit: Callable[..., Any]) -> None:
    stand_in = scenes.emergency()
    with opened(visit, stand_in, "question") as page:
        queue = stand_in.state["queue"]
        stand_in.change(queue={**queue, "open": queue["open"][1:], "queries": 24})
        page.wait_for_function("() => document.querySelector('#of').textContent === ' of 24'")
        wait_for_query(page, 17)
        page.keyboard.press("ArrowLeft")
        wait_for_query(page, 18)
    assert [query for query, _ in stand_in.answers] == [17]


def test_what_could_not_be_saved_is_asked_again(visit: Callable[..., Any]) -> None:
    stand_in = scenes.emergency()
    with opened(visit, stand_in, "question") as page:
        stand_in.refuse = (503, "storage")
        page.keyboard.press("ArrowLeft")
        page.wait_for_function(
            "() => document.querySelector('#notice').textContent.includes('could not be saved')"
        )
        wait_for_query(page, 17)
        page.keyboard.press("ArrowRight")
        wait_for_query(page, 18)
    assert [body["preference"] for _, body in stand_in.answers] == ["second"]


def test_stopping_is_offered_and_can_be_declined(visit: Callable[..., Any]) -> None:
    stand_in = scenes.enough()
    with opened(visit, stand_in, "question") as page:
        assert page.is_visible("#offer")
        page.keyboard.press("g")
        assert not page.is_visible("#offer")
        stand_in.change(queue={**stand_in.state["queue"], "answered": 17})
        page.wait_for_selector("#offer", state="visible")
        page.keyboard.press("f")
        wait_for(page, "closing")
    assert stand_in.stopped


def test_no_stop_without_an_offer(visit: Callable[..., Any]) -> None:
    stand_in = scenes.emergency()
    with opened(visit, stand_in, "question") as page:
        page.keyboard.press("f")
        page.keyboard.press("ArrowLeft")
        wait_for_query(page, 18)
    assert not stand_in.stopped


# ---- For everybody -----------------------------------------------------------------------------------------


def test_the_keyboard_reaches_every_control_and_shows_where_it_is(visit: Callable[..., Any]) -> None:
    with opened(visit, scenes.emergency(), "question") as page:
        reached = []
        for _ in range(14):
            page.keyboard.press("Tab")
            name, visible = page.evaluate(
                """[document.activeElement.id || document.activeElement.dataset.answer,
                    getComputedStyle(document.activeElement.closest('.track') ?? document.activeElement)
                        .outlineStyle !== 'none']"""
            )
            if name:
                assert visible, name
                reached.append(name)
        controls = {"help", "play", "scrub", "speed", "counts", "left", "equal", "unsure", "right", "undo"}
        assert controls <= set(reached)


def test_the_keyboard_keeps_its_place_from_question_to_question(visit: Callable[..., Any]) -> None:
    stand_in = scenes.emergency()
    with opened(visit, stand_in, "question") as page:
        page.focus("[data-answer=equal]")
        page.keyboard.press("Enter")
        wait_for_query(page, 18)
        page.keyboard.press("Space")
        wait_for_query(page, 19)
    assert [(query, body["preference"]) for query, body in stand_in.answers] == [(17, "equal"), (18, "equal")]


def test_the_slider_keeps_its_own_arrow_keys(visit: Callable[..., Any]) -> None:
    stand_in = scenes.emergency()
    with opened(visit, stand_in, "question") as page:
        page.keyboard.press("Home")
        page.focus("#scrub")
        page.keyboard.press("ArrowRight")
        assert page.evaluate(DRAWN)["left"]["moment"] > 0
    assert stand_in.answers == []


def test_help_lists_the_keys_and_takes_them_meanwhile(visit: Callable[..., Any]) -> None:
    stand_in = scenes.emergency()
    with opened(visit, stand_in, "question") as page:
        page.keyboard.press("h")
        assert "both are equally good" in page.inner_text("#help-dialog")
        page.keyboard.press("ArrowLeft")
        page.keyboard.press("Escape")
        assert not page.is_visible("#help-dialog")
        wait_for_query(page, 17)
    assert stand_in.answers == []


def test_a_screen_reader_hears_what_happens(visit: Callable[..., Any]) -> None:
    stand_in = scenes.emergency()
    with opened(visit, stand_in, "question") as page:
        steps = [event["step"] for event in stand_in.queries[17][1]["events"] if event["cell"] is not None]
        text = page.get_attribute("#right canvas", "aria-label")
        assert text.startswith("The right episode. 75 steps.")
        assert f"people saved at step {steps[0]}" in text
        page.keyboard.press("ArrowRight")
        page.wait_for_function(
            "() => document.querySelector('#announce').textContent === 'Recorded: Right is better.'"
        )
        assert page.get_attribute("#announce", "aria-live") == "polite"


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_stands_out_from_what_is_behind_it(visit: Callable[..., Any], scheme: str) -> None:
    """WCAG 2.2, 1.4.3 and 1.4.11: 4.5 for text, 3 for what carries meaning without it."""
    read = "name => getComputedStyle(document.documentElement).getPropertyValue('--' + name)"
    with opened(visit, scenes.emergency(), "question", color_scheme=scheme) as page:
        colours = {
            name: luminance(page.evaluate(read, name))
            for name in ("paper", "card", "ink", "soft", "warn", "bad", "left", "right", "floor", "on-strong")
        }
    for text in ("ink", "soft", "warn", "bad"):
        for ground in ("paper", "card"):
            assert contrast(colours[text], colours[ground]) >= 4.5, (text, ground)
    for side in ("left", "right"):
        assert contrast(colours[side], colours["card"]) >= 3
        assert contrast(colours[side], colours["on-strong"]) >= 4.5


def luminance(colour: str) -> float:
    """Relative luminance of #rrggbb, as WCAG defines it."""
    channels = np.array([int(colour.strip()[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(one: float, other: float) -> float:
    return (max(one, other) + 0.05) / (min(one, other) + 0.05)


# ---- Demonstrations ----------------------------------------------------------------------------------------


def play(page: Any, world: World, seed: int, wanted: list[str]) -> list[int]:
    """Play an episode by the keyboard, each key once the page has taken the one before."""
    actions = scenes.solve(world, seed, wanted)
    for step, action in enumerate(actions):
        page.wait_for_function(
            f"step => document.body.dataset.state === 'playing' && {DRAWN}.step === step", arg=step
        )
        page.keyboard.press(KEYS[action])
    wait_for(page, "review")
    return actions


def test_three_demonstrations_by_the_keyboard(visit: Callable[..., Any]) -> None:
    world = emergency_v0.world(max_cycles=8)
    stand_in = scenes.demonstrating(world, wanted=3)
    with opened(visit, stand_in, "playing", reduced_motion="no-preference") as page:
        assert stand_in.state["demonstrations"]["instruction"] in page.inner_text("main")
        played = []
        for seed in range(3):
            played.append(play(page, world, seed, ["people"]))
            page.keyboard.press("k")
        wait_for(page, "enough")
        assert page.inner_text("#kept") == "3"
    assert [episode["actions"] for episode in stand_in.kept] == played


def test_a_discarded_episode_is_not_kept(visit: Callable[..., Any]) -> None:
    world = delivery_v0.world(max_cycles=12)
    stand_in = scenes.demonstrating(world, wanted=1)
    with opened(visit, stand_in, "playing") as page:
        play(page, world, 0, ["people"])
        page.keyboard.press("x")
        actions = play(page, world, 1, ["pollution"])
        page.keyboard.press("k")
        wait_for(page, "enough")
    assert [episode["actions"] for episode in stand_in.kept] == [actions]


def test_what_is_drawn_while_playing_is_what_is_there(visit: Callable[..., Any]) -> None:
    world = delivery_v0.world(max_cycles=20)
    stand_in = scenes.demonstrating(world)
    with opened(visit, stand_in, "playing") as page:
        game = stand_in.games["play0"]
        for step, action in enumerate(scenes.solve(world, 0, ["deliveries", "people"])[:-1]):
            page.keyboard.press(KEYS[action])
            page.wait_for_function(f"step => {DRAWN}.step === step", arg=step + 1)
            drawn = page.evaluate(DRAWN)["left"]
            assert things(drawn, "agent") == {tuple(game.cell)}
            for kind in world.objects:
                there = {tuple(thing["cell"]) for thing in game.present if thing["kind"] == kind.name}
                assert things(drawn, kind.pattern) == there


def test_the_pad_and_the_shifted_arrows_act(visit: Callable[..., Any]) -> None:
    stand_in = scenes.demonstrating(emergency_v0.world())
    with opened(visit, stand_in, "playing") as page:
        page.click("#pads [aria-label='move down']")
        page.wait_for_function(f"() => {DRAWN}.step === 1")
        page.keyboard.press("Shift+ArrowLeft")
        page.wait_for_function(f"() => {DRAWN}.step === 2")
        page.click("#pads [aria-label='reach right']")
        page.wait_for_function(f"() => {DRAWN}.step === 3")
        assert stand_in.games["play0"].actions == [1, 7, 8]


def test_a_step_whose_reply_was_lost_is_taken_once(visit: Callable[..., Any]) -> None:
    stand_in = scenes.demonstrating(emergency_v0.world())
    with opened(visit, stand_in, "playing") as page:
        stand_in.lose_reply = True
        page.keyboard.press("ArrowDown")
        # Its stream broke with it: until it has another, the page takes no key.
        wait_until(page, lambda: stand_in.streams == 2)
        page.wait_for_function(f"() => {DRAWN}.state === 'playing' && {DRAWN}.step === 1")
        page.keyboard.press("ArrowRight")
        page.wait_for_function(f"() => {DRAWN}.step === 2")
        assert stand_in.games["play0"].actions == [1, 3]


def test_an_episode_that_the_server_forgot_is_replaced(visit: Callable[..., Any]) -> None:
    stand_in = scenes.demonstrating(emergency_v0.world())
    with opened(visit, stand_in, "playing") as page:
        stand_in.games.clear()
        stand_in.games["other"] = stand_in.games["another"] = scenes.Game(stand_in.world, 7)
        page.keyboard.press("ArrowDown")
        wait_until(page, lambda: "play2" in stand_in.games)
        page.wait_for_function(f"() => {DRAWN}.step === 0")
        assert page.inner_text("#notice") != ""
