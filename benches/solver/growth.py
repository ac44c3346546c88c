"""Draws CPU time against cameras from the raw output of growth.sh or run.sh: growth.py RUN OUT.svg"""
import re
import sys

rows, cameras = [], None
for line in open(sys.argv[1]):
    if found := re.match(r"== street of (\d+) cameras$", line.strip()):
        cameras = int(found[1])
    elif line.startswith("==") or cameras is None:
        cameras = None if line.startswith("==") else cameras
    elif found := re.match(r"(lsfb|ceres).*cpu ([\d.]+) s", line):
        rows.append((found[1], cameras, float(found[2])))
top = 1.1 * max(r[2] for r in rows)
x = lambda n: 60 + 500 * n / 1000
y = lambda s: 300 - 270 * s / top
out = ['<svg xmlns="http://www.w3.org/2000/svg" width="600" height="350" font-family="sans-serif" font-size="12">']
out.append('<rect width="600" height="350" fill="white"/>')
for n in (0, 200, 400, 600, 800, 1000):
    out.append(f'<text x="{x(n)}" y="318" text-anchor="middle">{n}</text>')
for k in range(5):
    s = top * k / 4
    out.append(f'<line x1="60" x2="560" y1="{y(s):.1f}" y2="{y(s):.1f}" stroke="#ddd"/>')
    out.append(f'<text x="52" y="{y(s) + 4:.1f}" text-anchor="end">{s:.0f}</text>')
out.append('<text x="310" y="340" text-anchor="middle">cameras (about 370 points and 2 850 observations each)</text>')
out.append('<text x="14" y="165" text-anchor="middle" transform="rotate(-90 14 165)">CPU time to solve, s</text>')
for name, colour in (("lsfb", "#1665c0"), ("ceres", "#c03a16")):
    line = [(x(n), y(s)) for who, n, s in rows if who == name]
    out.append(f'<polyline fill="none" stroke="{colour}" stroke-width="2" points="' + " ".join(f"{a:.1f},{b:.1f}" for a, b in line) + '"/>')
    out += [f'<circle cx="{a:.1f}" cy="{b:.1f}" r="3" fill="{colour}"/>' for a, b in line]
    a, b = line[-1]
    out.append(f'<text x="{a - 8:.1f}" y="{b - 8:.1f}" text-anchor="end" fill="{colour}">{name}</text>')
out.append("</svg>")
open(sys.argv[2], "w").write("\n".join(out) + "\n")
