"""Wrap docstring and comment lines over 100 characters that ruff reports (E501). usage: wrap.py RUFF"""
import collections, re, subprocess, sys
out = subprocess.run([sys.argv[1], "check", "--select", "E501", "--output-format", "concise", "."], capture_output=True, text=True).stdout
found = collections.defaultdict(list)
for path, line in re.findall(r"^(\S+?):(\d+):\d+: E501", out, re.M):
    found[path].append(int(line))
for path, numbers in found.items():
    lines = open(path).read().split("\n")
    for number in sorted(numbers, reverse=True):
        text = lines[number - 1]
        indent = re.match(r"\s*(?:# )?", text)[0]
        is_comment = indent.strip() == "#"
        in_docstring = not is_comment and not re.search(r"[=(){}]|^\s*(?:def|class|return|assert|with|for|if)\b", text.replace("`", ""))
        if not (is_comment or in_docstring):
            continue
        cut = text.rfind(" ", 0, 100)
        lines[number - 1] = text[:cut]
        following = lines[number] if number < len(lines) else ""
        rest = text[cut + 1 :]
        same = re.match(r"\s*(?:# )?", following)[0]
        if following.strip() and len(same + rest + " " + following.strip()) <= 100 and not re.match(r"\s*\w+: ", following) and following.strip() not in ("\"\"\"",):
            lines[number] = same + rest + " " + following[len(same):]
        else:
            lines.insert(number, indent + rest)
    open(path, "w").write("\n".join(lines))
print({p: len(n) for p, n in found.items()})
