"""HTML pages as tests read them: parsed, and shown by a browser that has no network."""

import os
import re
import shutil
from contextlib import contextmanager
from dataclasses import dataclass, field
from html.parser import HTMLParser

VOID = {"meta", "br", "hr", "img", "link", "input"}


class Page(HTMLParser):
    """What is on a page: text, tags, attributes; every tag must be closed in turn."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.attributes, self.words = [], [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)

    @property
    def text(self):
        return re.sub(r"\s+", " ", " ".join(self.words))

    @property
    def ids(self):
        found = [value for name, value in self.attributes if name == "id"]
        assert len(found) == len(set(found)), "ids are unique"
        return set(found)

    @property
    def sources(self):
        """What it would load from elsewhere."""
        names = ("src", "href", "xlink:href")
        return [v for name, v in self.attributes if name in names and not v.startswith("#")]


CHROMIUM = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
FLAGS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
]  # fmt: skip

# Five pictures a second in place of sixty: the processor draws them, there is no graphics card.
FEW_FRAMES = """
const draw = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = (frame) => setTimeout(() => draw(frame), 190);
window.cancelAnimationFrame = (number) => clearTimeout(number);
"""


def chromium():
    wanted = os.environ.get("MULTIARM_CHROMIUM")
    found = wanted or next(filter(None, map(shutil.which, CHROMIUM)), None)
    assert found, f"no browser: install one of {CHROMIUM} or set MULTIARM_CHROMIUM to its path"
    return found


@dataclass
class View:
    """A page in the browser and what it complained about or asked the network for."""

    page: object
    complaints: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def open(self, address):
        self.page.on("console", lambda m: m.type == "error" and self.complaints.append(m.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(address)


@contextmanager
def shown(browser, target):
    """A page in the browser, which complains about nothing and asks for nothing but itself."""
    page = browser.new_page(offline=True)
    complaints, requests = [], []
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda asked: requests.append(asked.url))
    page.goto(target.as_uri())
    yield page
    assert complaints == []
    assert requests == [target.as_uri()]
    page.close()


def sticks_out(page):
    """How many pixels a page is wider than its window."""
    return page.evaluate("document.documentElement.scrollWidth - window.innerWidth")


def brightness(page, selector, name):
    """The mean of red, green and blue of a colour in a computed style."""
    colour = page.eval_on_selector(selector, f"e => getComputedStyle(e).{name}")
    parts = [int(part) for part in re.findall(r"\d+", colour)[:3]]
    return sum(parts) / len(parts)
