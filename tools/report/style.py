"""The report's style sheet."""

STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0; background: #ffffff; color: #1a1a1a; line-height: 1.5;
  font: 16px/1.5 system-ui, -apple-system, "Segoe UI", "DejaVu Sans", Verdana, sans-serif; }
main { max-width: 1120px; margin: 0 auto; padding: 2rem 1.5rem 4rem; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .4rem; }
h2 { font-size: 1.3rem; margin: 0 0 .6rem; padding-top: .5rem; }
header { border-bottom: 3px solid #0072b2; padding-bottom: .6rem; margin-bottom: 1.2rem; }
header p { margin: .2rem 0; }
.origin { color: #4d4d4d; font-size: .9rem; overflow-wrap: anywhere; }
.note { border-left: 5px solid #d55e00; background: #fdf1ea; padding: .6rem 1rem; margin: .6rem 0; }
.cards { display: grid; gap: .8rem; margin: 1.2rem 0 2rem;
  grid-template-columns: repeat(auto-fit, minmax(165px, 1fr)); }
.card { border: 1px solid #d0d0d0; border-radius: 8px; padding: .7rem .9rem;
  display: flex; flex-direction: column; }
.card .name { font-size: .85rem; color: #4d4d4d; }
.card .value { white-space: nowrap; font-size: 1.6rem; font-weight: 650; line-height: 1.3; }
.card .more { font-size: .82rem; color: #4d4d4d; margin-top: auto; }
section { margin: 2.4rem 0; }
figure { margin: 0; }
figure svg { display: block; width: 100%; height: auto; }
figcaption { max-width: 62rem; font-size: .95rem; color: #262626; margin-top: .5rem; }
figcaption p { margin: .4rem 0; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: .8rem 0 1.4rem; }
th, td { padding: .32rem .7rem; text-align: right; border-bottom: 1px solid #dddddd; }
thead th { white-space: nowrap; border-bottom: 2px solid #4d4d4d; font-weight: 600; text-align: center; }
th[scope="row"] { text-align: left; font-weight: 600; }
.facts th[scope="row"] { font-weight: 400; }
.facts td { font-weight: 600; }
td.text, th.text { text-align: left; }
.errors { width: 100%; font-size: .9rem; }
.errors th, .errors td { padding: .32rem .45rem; }
details { margin: 1rem 0; border: 1px solid #d0d0d0; border-radius: 8px; padding: .6rem 1rem; }
summary { cursor: pointer; font-weight: 600; }
pre { white-space: pre-wrap; overflow-wrap: anywhere; font-size: .82rem; }
@media print {
  body { font-size: 10pt; }
  main { max-width: none; padding: 0; }
  section, .card, table { break-inside: avoid; }
  h2 { break-after: avoid; }
}
"""
