"""The datasheet as one page: facts, the questions a user of the data asks, histograms as inline SVG.

The questions follow Gebru et al. 2021, Datasheets for Datasets, DOI 10.1145/3458723.
"""

import html
import json

from data_synth.datasheet import Datasheet, Distribution, Tally

WIDTH, HEIGHT, FLOOR = 260, 92, 74
STYLE = """
:root{color-scheme:light dark;--ink:#1d2126;--soft:#656d76;--line:#d8dde3;--bar:#3b6ea8;--back:#fff;--card:#f6f8fa}
@media(prefers-color-scheme:dark){:root{--ink:#e6e9ed;--soft:#9aa4af;--line:#343b43;--bar:#7fb0e6;--back:#15181c;
--card:#1c2127}}
body{font:15px/1.5 system-ui,sans-serif;color:var(--ink);background:var(--back);max-width:72rem;margin:2rem auto;
padding:0 1rem}
h1{font-size:1.6rem;margin:0}h2{font-size:1.1rem;margin:2.2rem 0 .6rem;border-bottom:1px solid var(--line)}
dt{font-weight:600;margin-top:.7rem}dd{margin:0;max-width:60rem}.soft{color:var(--soft)}
.grid{display:grid;grid-template-columns:repeat(auto-fill,minmax(16.5rem,1fr));gap:.8rem}
figure{margin:0;background:var(--card);border:1px solid var(--line);border-radius:6px;padding:.6rem .7rem}
figcaption{font-size:.82rem;font-weight:600;min-height:2.4em}
figure p{margin:.2rem 0 0;font-size:.76rem;color:var(--soft)}
svg{width:100%;height:auto;display:block}rect{fill:var(--bar)}text{fill:var(--soft);font-size:10px}
line{stroke:var(--line)}table{border-collapse:collapse;font-size:.85rem;width:100%}td{padding:.1rem .3rem .1rem 0}
td.n{text-align:right;white-space:nowrap}.meter{background:var(--bar);height:.7rem;display:inline-block;min-width:1px}
pre{background:var(--card);padding:.6rem;overflow:auto;font-size:.8rem}
"""
PROCEDURAL = (
    "Procedural heads: no person's scan or photo is in them, only the mean, spread and principal directions of a "
    "population's 68 landmarks that they are calibrated against"
)
SCANNED = "A head scan that the user of the generator brought; whose it is and what it may be used for, they must say"


def page(sheet: Datasheet) -> str:
    """HTML text, self-contained, without scripts or anything loaded from elsewhere."""
    kinds = {str(s.get("kind")) for s in sheet.settings.values()}
    sources = [text for text, there in ((PROCEDURAL, kinds != {"scan"}), (SCANNED, "scan" in kinds)) if there]
    answers = (
        (
            "What is it?",
            f"{sheet.scenes} scenes, {sheet.pictures} pictures of heads with exact truth. A scene is "
            "one head under one light, seen by several calibrated cameras.",
        ),
        ("Whom does it show?", ". ".join(sources) + "."),
        ("What is it for?", "Training and measuring reconstruction of heads: shape, material and light from pictures."),
        (
            "What is it not for?",
            "Statements about people or groups of people, recognition, or measuring how well "
            "something works on real photographs.",
        ),
        (
            "How was it made?",
            "Rendered by numerical integration of the light with shadow rays: no light that bounces, "
            "no light that passes below the skin, one roughness a scene, surfaces instead of strands of hair.",
        ),
        ("Is anything random?", "All from the seeds below: the same settings and generator give the same bytes."),
        (
            "Which truth is exact?",
            "Geometry, albedo, specular, cameras and light. The radiance maps and the lobes' "
            "visibility are Monte Carlo estimates and carry its noise.",
        ),
    )
    parts = [
        "<!doctype html><html lang='en'><meta charset='utf-8'><meta name='viewport' content='width=device-width'>",
        f"<title>Datasheet: {sheet.scenes} synthetic scenes</title><style>{STYLE}</style>",
        f"<h1>Datasheet</h1><p class='soft'>{sheet.scenes} scenes, {sheet.pictures} pictures</p><dl>",
        *(f"<dt>{html.escape(q)}</dt><dd>{html.escape(a)}</dd>" for q, a in answers),
        "</dl>",
    ]
    for group, figures in sheet.by_group.items():
        shown = [figure_html(figure) for figure in figures if not isinstance(figure, Distribution) or figure.count]
        if shown:
            parts.append(f"<h2>{html.escape(group)}</h2><div class='grid'>{''.join(shown)}</div>")
    parts.append("<h2>Settings</h2>")
    parts += [
        f"<p>{html.escape(name)}</p><pre>{html.escape(json.dumps(settings, indent=1))}</pre>"
        for name, settings in sheet.settings.items()
    ]
    return "\n".join(parts) + "\n</html>\n"


def figure_html(figure: Distribution | Tally) -> str:
    """One card."""
    name = html.escape(figure.name.replace("_", " "))
    if isinstance(figure, Tally):
        total = max(sum(count for _, count in figure.counts), 1)
        rows = "".join(
            f"<tr><td>{html.escape(word)}</td><td class='n'>{count}</td><td class='n'>{100 * count / total:.0f} %</td>"
            f"<td><span class='meter' style='width:{5 * count / total:.2f}rem'></span></td></tr>"
            for word, count in figure.counts
        )
        return f"<figure><figcaption>{name}</figcaption><table>{rows}</table></figure>"
    unit = html.escape(f" {figure.unit}" if figure.unit else "")
    caption = f"{name}<span class='soft'>{unit}</span>"
    moments = f"mean {figure.mean:.3g}, sd {figure.std:.3g}, median {figure.median:.3g}, n {figure.count}"
    return f"<figure><figcaption>{caption}</figcaption>{histogram_svg(figure)}<p>{moments}</p></figure>"


def histogram_svg(figure: Distribution) -> str:
    """The histogram; the tallest bar reaches the top, the least and the most stand below."""
    tallest = max(figure.counts)
    step = WIDTH / len(figure.counts)
    bars = []
    for k, count in enumerate(figure.counts):
        height = (FLOOR - 4) * count / tallest
        title = f"{figure.edges[k]:.3g} to {figure.edges[k + 1]:.3g}: {count}"
        bars.append(
            f'<rect x="{k * step + 0.5:.1f}" y="{FLOOR - height:.1f}" width="{step - 1:.1f}" height="{height:.1f}">'
            f"<title>{title}</title></rect>"
        )
    label = html.escape(f"{figure.name}: {figure.least:.3g} to {figure.most:.3g}")
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{label}">{"".join(bars)}'
        f'<line x1="0" x2="{WIDTH}" y1="{FLOOR}" y2="{FLOOR}"/><text x="0" y="{FLOOR + 14}">{figure.least:.3g}</text>'
        f'<text x="{WIDTH}" y="{FLOOR + 14}" text-anchor="end">{figure.most:.3g}</text></svg>'
    )
