"""Compare Python files with a git revision: is the code the same but for docstrings, comments, strings?

usage: python prose_check.py [--base main] [paths...]     (run in a worktree; default: every changed .py file)
Prints CODE where something else than docstrings and string constants changed, and every changed string
(grep the tests for it).
"""
import ast, subprocess, sys, difflib
args=sys.argv[1:]; base='main'
if args and args[0]=='--base': base=args[1]; args=args[2:]
base=subprocess.check_output(['git','merge-base','HEAD',base],text=True).strip()
files=args or [f for f in subprocess.check_output(['git','diff','--name-only',base],text=True).split() if f.endswith('.py')]
class Strip(ast.NodeTransformer):
    def __init__(s): s.strings=[]
    def _doc(s,n):
        s.generic_visit(n)
        b=n.body
        if b and isinstance(b[0],ast.Expr) and isinstance(b[0].value,ast.Constant) and isinstance(b[0].value.value,str): b=b[1:]
        n.body=b or [ast.Pass()]
        return n
    visit_Module=visit_FunctionDef=visit_AsyncFunctionDef=visit_ClassDef=_doc
    def visit_Expr(s,n):
        if isinstance(n.value,ast.Constant) and isinstance(n.value.value,str): return ast.Expr(ast.Constant('S'))
        s.generic_visit(n); return n
    def visit_JoinedStr(s,n):
        s.strings.append(ast.unparse(n)); return ast.Constant('S')
    def visit_Constant(s,n):
        if isinstance(n.value,str): s.strings.append(n.value); return ast.Constant('S')
        return n
    def visit_BinOp(s,n):
        s.generic_visit(n); return n
bad=0
for f in files:
    try: new=open(f).read()
    except FileNotFoundError: print('GONE',f); continue
    try: old=subprocess.check_output(['git','show',f'{base}:{f}'],text=True,stderr=subprocess.DEVNULL)
    except subprocess.CalledProcessError: print('NEW',f); continue
    a,b=Strip(),Strip(); A=ast.unparse(a.visit(ast.parse(old))); B=ast.unparse(b.visit(ast.parse(new)))
    if A!=B:
        bad+=1; print('CODE',f)
        for l in difflib.unified_diff(A.splitlines(),B.splitlines(),lineterm='',n=0):
            if l[:1] in '+-' and l[:3] not in('+++','---'): print('   ',l)
    for l in difflib.unified_diff(a.strings,b.strings,lineterm='',n=0):
        if l[:1] in '+-' and l[:3] not in('+++','---'): print('  STR',l[:200])
print('code changed in',bad,'files')
