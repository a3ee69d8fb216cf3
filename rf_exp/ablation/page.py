"""The frame of the report: one HTML file with its style, readable on a phone and in dark mode."""

from html import escape
from math import ceil

from rf_exp.ablation.formats import CLEAN, MISSING, clean_figure, details, figure, is_long, notes
from rf_exp.ablation.tables import Cell, Column, Table

ABREAST = 5  # columns of figures that a page of 1400 pixels holds
CSS = """
:root { color-scheme: light dark; --page: #fbfbfa; --card: #fff; --ink: #1d2024; --soft: #5d646d;
  --line: #d9dce0; --ours: #0b6bcb; --paper: #c2410c; --c3: #15803d; --c4: #7e22ce; --c5: #a16207; }
@media (prefers-color-scheme: dark) { :root { --page: #14161a; --card: #1c1f25; --ink: #e7e9ec;
  --soft: #a0a7b1; --line: #383d46; --ours: #62aeff; --paper: #ff9d5c; --c3: #6fd08c; --c4: #cf9bff;
  --c5: #e2c25b; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.2rem 1rem 4rem; max-width: 80rem; background: var(--page);
  color: var(--ink); font: 16px/1.55 system-ui, sans-serif; overflow-wrap: anywhere; }
h1 { margin: .4rem 0 .2rem; font-size: 1.8rem; line-height: 1.2; }
h2 { margin: 2.6rem 0 .3rem; font-size: 1.3rem; line-height: 1.25; }
h3 { margin: 0 0 .3rem; font-size: 1rem; }
p { margin: .3rem 0 .8rem; } .soft, figcaption, caption { color: var(--soft); font-size: .9rem; }
nav { display: flex; flex-wrap: wrap; gap: .1rem 1.1rem; padding: .5rem 0; margin: .8rem 0;
  border: solid var(--line); border-width: 1px 0; font-size: .95rem; }
a { color: var(--ours); } code, pre { font: .88em ui-monospace, monospace; }
pre { padding: .8rem; overflow-x: auto; background: var(--card); border: 1px solid var(--line);
  border-radius: 8px; overflow-wrap: normal; }
.tiles, .panels { display: grid; gap: .8rem; margin: .8rem 0; }
.tiles { grid-template-columns: repeat(auto-fit, minmax(10rem, 1fr)); }
.panels { grid-template-columns: repeat(auto-fill, minmax(min(20rem, 100%), 1fr)); }
.tile, .panel { padding: .8rem; margin: 0; background: var(--card); border: 1px solid var(--line);
  border-radius: 10px; }
.tile b { display: block; font-size: 1.5rem; line-height: 1.3; font-variant-numeric: tabular-nums; }
.panel svg, .panel img, .panel video { display: block; width: 100%; height: auto; }
.panel svg text { font-family: system-ui, sans-serif !important; }
.panel img, .panel video { border-radius: 6px; }
.strip { display: grid; grid-template-columns: repeat(4, 1fr); gap: 3px; }
.wide { overflow-x: auto; margin-top: .8rem; background: var(--card); border: 1px solid var(--line);
  border-radius: 10px; }
table { border-collapse: collapse; width: 100%; font-size: .93rem; overflow-wrap: normal; }
th, td { padding: .5rem .7rem; text-align: left; vertical-align: top; border-top: 1px solid var(--line); }
thead th { border-top: 0; vertical-align: bottom; } tbody th { font-weight: 600; }
tbody th:first-child { position: sticky; left: 0; background: var(--card); min-width: 7rem; }
td.figure { font-variant-numeric: tabular-nums; } td.figure b, td.figure small { white-space: nowrap; }
details td { min-width: 15rem; }
td b { font-size: 1.05rem; } td b ~ b { display: inline-block; margin-top: .45rem; }
td small, td span { color: var(--soft); font-size: .78rem; } td small { display: block; line-height: 1.35; }
td small.paper { color: var(--paper); }
td .missing { font-size: inherit; font-style: italic; }
tr.average > * { background: color-mix(in srgb, var(--line) 35%, var(--card)) !important; }
ul.notes { margin: .6rem 0; padding-left: 1.1rem; color: var(--soft); font-size: .88rem; }
.key { display: inline-block; width: .7em; height: .7em; border-radius: 50%; background: var(--ours); }
.key.paper { background: none; border: 2px solid var(--paper); border-radius: 0; transform: rotate(45deg); }
details { margin: .6rem 0; } summary { cursor: pointer; }
"""


def document(title: str, sections: list[tuple[str, str, str]], lead: str) -> str:
    """The page: (anchor, heading, content) for each section, reachable from the top."""
    links = "".join(f'<a href="#{anchor}">{escape(heading)}</a>' for anchor, heading, _ in sections)
    body = "".join(
        f'<section id="{anchor}"><h2>{escape(heading)}</h2>{content}</section>\n'
        for anchor, heading, content in sections
    )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{CSS}</style></head>\n<body>\n"
        f"<header><h1>{escape(title)}</h1>{lead}</header><nav>{links}</nav>\n<main>{body}</main></body></html>\n"
    )


def table_html(table: Table) -> str:
    """Caption, table and notes. Below each figure of ours what belongs to it, and the paper's figure.

    Violations stand in the field of the figure that they are of. More columns than fit side by side go on
    below, and those of long texts follow in a table of their own that is folded away.
    """
    long = {i for i in range(len(table.columns)) if is_long(table, i)}
    texts = [i for i, column in enumerate(table.columns) if column.unit == "text" and i not in long]
    figures = [index for index, _ in table.compared]
    rows = max(1, ceil(len(figures) / ABREAST))
    each = ceil(len(figures) / rows)
    shown = "".join(_block(table, sorted([*texts, *figures[k * each : (k + 1) * each]])) for k in range(rows))
    folded = ""
    if long:
        titles = [table.columns[i].title for i in sorted(long)]
        told = [[line.title, *(str(line.cells[i].value or "") for i in sorted(long))] for line in table.lines]
        inside = plain_table([table.heading, *titles], told)
        folded = f"<details><summary>{escape(' and '.join(titles))}</summary>{inside}</details>"
    return f'<p class="soft">{escape(table.caption)}</p>{shown}{folded}{bullets(notes(table))}'


def _block(table: Table, shown: list[int]) -> str:
    """The table with these of its columns."""
    heading = "".join(f"<th>{escape(table.columns[i].title)}</th>" for i in shown)
    after, rows = dict(table.compared), []
    for line in table.lines:
        kind = ' class="average"' if line.title == "Average" else ""
        beside = {i: line.cells[k] for i, k in after.items() if k is not None}
        cells = [_cell(line.cells[i], table.columns[i], beside.get(i)) for i in shown]
        rows.append(f"<tr{kind}><th>{escape(line.title)}</th>{''.join(cells)}</tr>")
    return (
        f'<div class="wide"><table><thead><tr><th>{escape(table.heading)}</th>{heading}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def plain_table(heading: list[str], rows: list[list[str]]) -> str:
    """A table of texts."""
    top = "".join(f"<th>{escape(text)}</th>" for text in heading)
    body = "".join(
        "<tr>" + f"<th>{escape(first)}</th>" + "".join(f"<td>{escape(text)}</td>" for text in rest) + "</tr>"
        for first, *rest in rows
    )
    return f'<div class="wide"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def tiles(items: list[tuple[str, str]]) -> str:
    """Large figures with what they are."""
    inside = "".join(
        f'<div class="tile"><b>{escape(value)}</b><span class="soft">{escape(what)}</span></div>'
        for value, what in items
    )
    return f'<div class="tiles">{inside}</div>'


def panels(items: list[tuple[str, str]]) -> str:
    """(title, markup) as cards, as many a row as fit; nothing without items."""
    inside = "".join(
        f'<figure class="panel"><h3>{escape(title)}</h3>{markup}</figure>' for title, markup in items
    )
    return f'<div class="panels">{inside}</div>' if items else ""


def bullets(items: list[str]) -> str:
    return f'<ul class="notes">{"".join(f"<li>{escape(item)}</li>" for item in items)}</ul>' if items else ""


def _cell(cell: Cell, column: Column, violations: Cell | None) -> str:
    """Success, success without a violation and violations, one as large as the other."""
    if column.unit == "text":
        return f"<td>{escape(figure(cell.value, column.unit))}</td>"
    if cell.value is None:
        parts = [f'<span class="missing">{MISSING}</span>']
    else:
        parts = [_figure(figure(cell.value, column.unit), "", details(cell, column.unit))]
    if cell.paper is not None:
        parts.append(f'<small class="paper">paper {figure(cell.paper, column.unit)}</small>')
    if cell.clean:
        rate, interval = clean_figure(cell.clean)
        parts.append(_figure(rate, CLEAN, [interval]))
    if violations and violations.mean_violations is not None:
        share = figure(violations.value, "violations")
        parts.append(_figure(share, "violations", [" ".join(details(violations, "violations"))]))
    return f'<td class="figure">{"".join(parts)}</td>'


def _figure(value: str, what: str, below: list[str]) -> str:
    told = f" <span>{what}</span>" if what else ""
    return f"<b>{value}</b>{told}" + "".join(f"<small>{text}</small>" for text in below)
