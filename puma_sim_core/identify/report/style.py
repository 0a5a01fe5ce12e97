# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""How the report looks: on a screen, on a phone, on paper. Nothing is fetched from anywhere."""

CSS = """
:root { --ink: #1c1f23; --soft: #525a63; --line: #d6dade; --wash: #f4f6f8; --link: #0b57a4;
  --nominal: #979ea5; --retuned: #c8500a; --augmented: #0060a8; --tone: #0b57a4; }
.NOTHING_MISSING { --tone: #1d6b3c; }
.NAMED_WITH_REMAINDER, .UNNAMED { --tone: #9a4600; }
.DATA_FAULT { --tone: #a3202a; }
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; }
body { margin: 0; color: var(--ink); background: #fff;
  font: 1rem/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial,
    sans-serif; }
main, header, nav, footer { max-width: 68rem; margin: 0 auto; padding: 0 1rem; }
header { padding-top: 1.4rem; }
.from { color: var(--soft); font-size: .9rem; margin: 0 0 .7rem; overflow-wrap: anywhere;
  max-width: none; }
.badge { display: inline-block; color: #fff; background: var(--tone); font-weight: 600;
  font-size: .82rem; letter-spacing: .03em; padding: .12rem .6rem; border-radius: .25rem;
  print-color-adjust: exact; -webkit-print-color-adjust: exact; }
h1 { font-size: 1.75rem; line-height: 1.25; margin: .6rem 0 1.1rem; max-width: 52rem;
  overflow-wrap: break-word; text-wrap: pretty; }
h2 { font-size: 1.3rem; line-height: 1.25; margin: 2.8rem 0 .5rem; padding-top: .6rem;
  border-top: 2px solid var(--ink); }
h3 { font-size: 1.02rem; margin: 1.6rem 0 .4rem; }
p { max-width: 46rem; margin: .5rem 0; overflow-wrap: break-word; }
a { color: var(--link); }
code { font: .92em/1.45 ui-monospace, "SF Mono", "DejaVu Sans Mono", Menlo, Consolas, monospace;
  overflow-wrap: anywhere; }
pre { background: var(--wash); border: 1px solid var(--line); border-radius: .3rem;
  padding: .6rem .8rem; white-space: pre-wrap; overflow-wrap: anywhere; margin: .6rem 0; }
.answers { display: grid; gap: 1rem; margin: 0;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 16rem), 1fr)); }
.answers > div { border: 1px solid var(--line); border-top: 4px solid var(--tone);
  border-radius: .3rem; padding: .7rem .9rem .8rem; min-width: 0; }
.answers h2 { border: 0; margin: 0 0 .3rem; padding: 0; font-size: .85rem; color: var(--soft);
  font-weight: 600; }
.answers p { margin: .3rem 0 0; font-size: .92rem; }
.answers .big { font-size: 1.2rem; line-height: 1.3; font-weight: 650; margin: 0; }
.answers p + .big { margin-top: .9rem; }
.meters { display: grid; grid-template-columns: auto minmax(2rem, 1fr) auto; gap: .2rem .6rem;
  align-items: center; margin: .5rem 0 .2rem; font-size: .9rem; }
.meters b { font-variant-numeric: tabular-nums; text-align: right; font-weight: 600; }
.meters i { display: block; height: .8rem; border-radius: .1rem; min-width: 2px;
  print-color-adjust: exact; -webkit-print-color-adjust: exact; }
.nominal { background: var(--nominal); } .retuned { background: var(--retuned); }
.augmented { background: var(--augmented); } .floor { background: var(--ink); }
nav ul { list-style: none; display: flex; flex-wrap: wrap; gap: .15rem 1.1rem; padding: 0;
  margin: 1.1rem 0 0; font-size: .9rem; }
nav a { display: inline-block; padding: .2rem 0; }
table { border-collapse: collapse; width: 100%; font-size: .9rem; margin: .6rem 0 1rem; }
caption { text-align: left; font-weight: 600; padding: .3rem 0; }
th, td { text-align: left; vertical-align: top; padding: .32rem .8rem .32rem 0;
  border-bottom: 1px solid var(--line); overflow-wrap: break-word; }
th:last-child, td:last-child { padding-right: 0; }
thead th { border-bottom: 1.5px solid var(--ink); font-size: .82rem; color: var(--soft);
  vertical-align: bottom; }
tbody th { font-weight: 500; }
tbody th[colspan] { font-weight: 600; padding-top: .8rem; color: var(--soft); font-size: .85rem; }
td.value, th.value { font-variant-numeric: tabular-nums; text-align: right; }
td.mean { font-weight: 650; }
table.narrow { max-width: 44rem; }
td.bar { width: 30%; min-width: 8rem; }
.gain { display: grid; grid-template-columns: 5.6rem 1fr; gap: .5rem; align-items: center;
  font-variant-numeric: tabular-nums; }
.gain b { font-weight: 500; text-align: right; white-space: nowrap; }
.gain i { display: block; height: .7rem; background: #b9c2cb; min-width: 1px;
  print-color-adjust: exact; -webkit-print-color-adjust: exact; }
tr.named .gain i { background: var(--augmented); } tr.tied .gain i { background: #7fb0d8; }
tr.named th, tr.tied th { font-weight: 650; }
.unseen { color: #8a3c00; font-weight: 600; }
.soft { color: var(--soft); }
sup { font-size: .72em; line-height: 0; }
.errors, .figures { display: grid; gap: 1.2rem 1.6rem;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 19.5rem), 1fr)); }
.figures { margin: 1rem 0; }
.errors { grid-template-columns: repeat(auto-fit, minmax(min(100%, 26rem), 1fr)); }
figure { margin: 0; min-width: 0; max-width: 31rem; }
figcaption { font-size: .9rem; font-weight: 600; line-height: 1.35; margin-bottom: .3rem; }
figure p { font-size: .86rem; color: var(--soft); margin: .2rem 0 0; }
svg.drawing { display: block; width: 100%; height: auto;
  print-color-adjust: exact; -webkit-print-color-adjust: exact; }
.legend { list-style: none; margin: .4rem 0 0; padding: 0; font-size: .88rem; display: flex;
  flex-wrap: wrap; gap: .1rem 1.2rem; }
.legend li { display: flex; align-items: center; gap: .45rem; }
.legend svg { flex: none; }
details { margin: .6rem 0; }
summary { cursor: pointer; color: var(--link); font-size: .92rem; padding: .2rem 0; }
ul.plain { margin: .5rem 0; padding-left: 1.2rem; max-width: 46rem; overflow-wrap: anywhere; }
dl.facts { display: grid; grid-template-columns: max-content 1fr; gap: .2rem 1.2rem;
  margin: .6rem 0; font-size: .92rem; }
dl.facts dt { color: var(--soft); } dl.facts dd { margin: 0; overflow-wrap: anywhere; }
footer { margin-top: 2.5rem; padding-bottom: 2rem; color: var(--soft); font-size: .86rem; }
@media screen and (max-width: 46rem) {
  .answers { gap: .7rem; }
  h1 { font-size: 1.35rem; margin-bottom: .9rem; }
  h2 { font-size: 1.15rem; margin-top: 2.2rem; }
  header { padding-top: .9rem; }
  table { font-size: .86rem; }
  th, td { padding-right: .45rem; }
  table.stack thead { position: absolute; width: 1px; height: 1px; overflow: hidden;
    clip-path: inset(50%); }
  table.stack tbody, table.stack th, table.stack td { display: block; width: auto; }
  table.stack tr { display: block; padding: .45rem 0; border-bottom: 1px solid var(--line); }
  table.stack th, table.stack td { border: 0; padding: .05rem 0; text-align: left; }
  table.stack tbody th { font-weight: 600; }
  table.stack td[data-name]::before { content: attr(data-name) ": "; color: var(--soft); }
  table.across tr { display: flex; flex-wrap: wrap; column-gap: 1.1rem; }
  table.across tbody th { flex: 0 0 100%; }
  .gain { grid-template-columns: 5.6rem 1fr; }
  .gain b { text-align: left; }
  .desk { display: none; }
  dl.facts { grid-template-columns: 1fr; gap: 0; }
  dl.facts dd { margin-bottom: .4rem; }
}
@media print {
  @page { margin: 14mm; }
  html { font-size: 8.6pt; }
  main, header, nav, footer { max-width: none; padding: 0; }
  nav { display: none; }
  h1 { font-size: 16pt; max-width: none; }
  h2 { font-size: 12.5pt; margin-top: 1.8rem; break-after: avoid; }
  h3, caption, figcaption, summary { break-after: avoid; }
  p { max-width: none; orphans: 3; widows: 3; }
  a { color: inherit; text-decoration: none; }
  tr, figure, .answers > div, pre { break-inside: avoid; }
  .answers { grid-template-columns: repeat(3, 1fr); gap: 3mm; }
  .errors { grid-template-columns: 1fr 1fr; }
  .figures { grid-template-columns: repeat(3, 1fr); gap: 4mm 5mm; }
  .figures.two { grid-template-columns: repeat(2, 1fr); }
  th, td { padding-top: .2rem; padding-bottom: .2rem; }
  details::details-content { content-visibility: visible; display: block; }
}
"""
