"""List docstrings and texts that break the rules of words. usage: python words_check.py PATH..."""
import ast, pathlib, re, sys, tokenize
OPEN={'What','Whether','Where','How','Who','Which','Of','Those','When','Whose','That','If'}
BAN=re.compile(r"\b(anew|beside|besides|whoever|whomever|whatever|wherever|whosever|take[ns]? up|taken from the other|amiss|dear|dearer|let go|lets go|ere|thereof|therein|thereby|where(?:of|in|by)|told|tells?|telling|hark|aught|naught|nought|unasked|of one's own|of its own|what is said|so many|so much|so often|said|say so|says so|no more than that|has no say|meanwhile|given up|gives up|give up)\b",re.I)
n=0
for root in sys.argv[1:]:
    for p in ([pathlib.Path(root)] if root.endswith('.py') else sorted(pathlib.Path(root).rglob('*.py'))):
        t=ast.parse(p.read_text())
        for x in ast.walk(t):
            if isinstance(x,(ast.Module,ast.ClassDef,ast.FunctionDef,ast.AsyncFunctionDef)):
                d=ast.get_docstring(x)
                if d and d.split()[0].strip(',.:;') in OPEN: n+=1; print(f"{p}:{getattr(x,'lineno',1)}: opens with {d.split()[0]}: {d.splitlines()[0][:80]}")
        with open(p,'rb') as f:
            for tok in tokenize.tokenize(f.readline):
                if tok.type in (tokenize.COMMENT,tokenize.STRING) or tok.type==getattr(tokenize,'FSTRING_MIDDLE',-1):
                    for m in BAN.finditer(tok.string):
                        n+=1; line=tok.start[0]+tok.string[:m.start()].count('\n'); print(f"{p}:{line}: {m.group(0)}: {tok.string[max(0,m.start()-40):m.end()+30]!r}")
print(n,'findings')
