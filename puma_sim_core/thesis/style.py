# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""How the page looks: on a screen, on a phone, on paper. Nothing is fetched from anywhere."""

CSS = """
:root { --ink: #1c1f23; --soft: #5a626b; --line: #d6dade; --wash: #f4f6f8; --link: #0b57a4;
  --differs: #a03a00; --agrees: #1d6b3c; }
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; scroll-behavior: smooth; }
body { margin: 0; color: var(--ink); background: #fff; line-height: 1.5;
  font: 1rem/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial,
    sans-serif; }
main, header, nav, footer { max-width: 64rem; margin: 0 auto; padding: 0 1rem; }
header { padding-top: 1.5rem; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .5rem; }
h2 { font-size: 1.3rem; line-height: 1.25; margin: 3rem 0 .5rem; padding-top: .6rem;
  border-top: 2px solid var(--ink); }
h2 .number { color: var(--soft); margin-right: .4em; font-variant-numeric: tabular-nums; }
h3 { font-size: 1rem; margin: 1.6rem 0 .4rem; }
p { max-width: 46rem; margin: .5rem 0; }
a { color: var(--link); }
nav ol { list-style: none; margin: .5rem 0; padding: 0; }
nav li { padding: .45rem 0; border-bottom: 1px solid var(--line); display: grid;
  grid-template-columns: 4.5rem 1fr; column-gap: .5rem; }
nav li .number { color: var(--soft); font-variant-numeric: tabular-nums; }
nav li a { font-weight: 600; text-decoration: none; }
nav li a:hover { text-decoration: underline; }
nav li p { margin: 0; color: var(--soft); font-size: .92rem; max-width: none; }
table { border-collapse: collapse; width: 100%; font-size: .9rem; margin: .6rem 0 1rem; }
caption { text-align: left; font-weight: 600; padding: .3rem 0; }
th, td { text-align: left; vertical-align: top; padding: .35rem .6rem .35rem 0;
  border-bottom: 1px solid var(--line); overflow-wrap: break-word; }
thead th { border-bottom: 1.5px solid var(--ink); font-size: .82rem; color: var(--soft); }
tbody th { font-weight: 500; width: 27%; min-width: 9rem; }
td.value { font-variant-numeric: tabular-nums; min-width: 6rem; white-space: pre-line; }
td.note { min-width: 14rem; }
table.words tbody th { width: 19%; }
table.words td.value { width: 18%; }
td.value.block { white-space: pre; overflow-x: auto; font-size: .92em;
  font-family: ui-monospace, "SF Mono", "DejaVu Sans Mono", Menlo, Consolas, monospace; }
td.note { color: var(--soft); }
sup { font-size: .72em; line-height: 0; }
.mark { font-size: .78rem; white-space: nowrap; font-weight: 600; display: block; }
.mark.differs { color: var(--differs); }
.mark.agrees { color: var(--agrees); }
.figures { display: grid; gap: 1.4rem 1.6rem; margin: 1.2rem 0;
  grid-template-columns: repeat(auto-fill, minmax(min(100%, 24rem), 1fr)); }
figure { margin: 0; min-width: 0; }
figcaption { font-size: .9rem; font-weight: 600; line-height: 1.35; margin-bottom: .3rem; }
svg.drawing { display: block; width: 100%; height: auto; }
.legend { list-style: none; margin: .3rem 0 0; padding: 0; font-size: .82rem; display: flex;
  flex-wrap: wrap; gap: .1rem .9rem; line-height: 1.4; }
.legend li { display: flex; align-items: baseline; gap: .4rem; min-width: 0; }
.legend svg { flex: none; }
figure p { font-size: .86rem; color: var(--soft); margin: .3rem 0 0; }
details { margin: .8rem 0; font-size: .86rem; }
summary { cursor: pointer; color: var(--link); }
dl.numbers { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 22rem), 1fr));
  gap: .1rem 1.6rem; margin: .5rem 0; }
dl.numbers div { display: flex; justify-content: space-between; gap: 1rem; min-width: 0;
  border-bottom: 1px dotted var(--line); }
dl.numbers dt { overflow-wrap: anywhere; color: var(--soft); }
dl.numbers dd { margin: 0; text-align: right; font-variant-numeric: tabular-nums;
  overflow-wrap: anywhere; }
footer { margin-top: 3rem; padding-bottom: 2rem; color: var(--soft); font-size: .86rem; }
.top { font-size: .82rem; }
@media screen and (max-width: 40rem) {
  h1 { font-size: 1.4rem; }
  h2 { font-size: 1.15rem; }
  nav li { grid-template-columns: 3.4rem 1fr; }
  table, tbody, th, td { display: block; width: auto !important; min-width: 0; }
  thead { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); }
  tbody tr { display: grid; grid-template-columns: 1fr 1fr; column-gap: .8rem; padding: .5rem 0;
    border-bottom: 1px solid var(--line); }
  tbody th, td.note { grid-column: 1 / -1; }
  td.printed:empty + td.ours { grid-column: 1 / -1; }
  td.value.block::before { display: block; font-family: system-ui, sans-serif; }
  table.words td { grid-column: 1 / -1; }
  th, td { border: 0; padding: .05rem 0; }
  tbody th, td.value, td.note { min-width: 0; }
  tbody th { font-weight: 600; }
  td[data-name]::before { content: attr(data-name) ": "; color: var(--soft); }
  td:empty { display: none; }
  .mark { display: inline; margin-left: .4em; }
}
@media print {
  @page { margin: 15mm 14mm; }
  html { font-size: 8.8pt; }
  body { line-height: 1.38; }
  main, header, nav, footer { max-width: none; padding: 0; }
  h1 { font-size: 17pt; }
  h2 { font-size: 12.5pt; margin-top: 2rem; break-after: avoid; }
  h3, caption, figcaption { break-after: avoid; }
  p { max-width: none; orphans: 3; widows: 3; }
  a { color: inherit; text-decoration: none; }
  thead { display: table-header-group; }
  tr, figure, nav li { break-inside: avoid; }
  nav li { padding: .25rem 0; }
  th, td { padding-top: .22rem; padding-bottom: .22rem; }
  .figures { grid-template-columns: 1fr 1fr; gap: 5mm 6mm; }
  .top, details { display: none; }
  footer { margin-top: 1rem; padding: 0; break-before: avoid; }
}
"""
