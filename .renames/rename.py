"""Rename public names across a worktree. usage: python3.12 rename.py TABLE.tsv [--dry]   (cwd: worktree root)

TABLE rows: path<TAB>kind<TAB>old<TAB>new[...]. kind: class, function, constant, method, attribute, module.
"""
import ast, collections, pathlib, re, subprocess, sys
dry='--dry' in sys.argv
files=[pathlib.Path(f) for f in subprocess.check_output(['git','ls-files','*.py'],text=True).split()]
def modname(p):
    parts=list(p.with_suffix('').parts)
    if parts[0] in('edge','exporters'):
        if parts[-1]=='__init__': parts.pop()
        return '.'.join(parts)
    return p.stem   # tests: by stem
src={p:p.read_text() for p in files}; tree={p:ast.parse(s) for p,s in src.items()}
mod={modname(p):p for p in files}
def resolve_rel(p,node):
    if not node.level: return node.module or ''
    base=modname(p).split('.')
    if p.name!='__init__.py': base=base[:-1]
    base=base[:len(base)-(node.level-1)]
    return '.'.join(base+([node.module] if node.module else []))
binds={}
for p,t in tree.items():
    b={}
    for n in ast.walk(t):
        if isinstance(n,ast.ImportFrom):
            m=resolve_rel(p,n)
            for a in n.names: b[a.asname or a.name]=(m,a.name)
        elif isinstance(n,ast.Import):
            for a in n.names:
                if a.asname: b[a.asname]=(a.name,None)
                else: b[a.name.split('.')[0]]=(a.name.split('.')[0],None)
    binds[p]=b
tops={}
for p,t in tree.items():
    s=set()
    for n in ast.walk(t):
        if isinstance(n,(ast.ClassDef,ast.FunctionDef,ast.AsyncFunctionDef)): s.add(n.name)
    for n in t.body:
        for x in (n.targets if isinstance(n,ast.Assign) else [n.target] if isinstance(n,ast.AnnAssign) else []):
            if isinstance(x,ast.Name): s.add(x.id)
    tops[p]=s
def origin(m,name,seen=()):
    if (m,name) in seen: return None
    p=mod.get(m)
    if p is None: return None
    full=f'{m}.{name}' if name else m
    if name is None: return ('module',m)
    if name in tops[p] : return (m,name)
    if name in binds[p]:
        mm,nn=binds[p][name]; return origin(mm,nn,seen+((m,name),))
    if full in mod: return ('module',full)
    return None
rows=[]
for path in [a for a in sys.argv[1:] if not a.startswith('--')]:
    for line in open(path):
        c=line.rstrip('\n').split('\t')
        if len(c)<4 or c[0].startswith('#') or c[2]==c[3]: continue
        rows.append(c[:4])
edits=collections.defaultdict(set)   # file -> (line, col, len_old, new)
warn=[]
# utf8 col -> char col
def charcol(p,l,c): return len(lines[p][l-1].encode()[:c].decode())
lines={p:s.split('\n') for p,s in src.items()}
def add(p,l,c,old,new,utf=True):
    c=charcol(p,l,c) if utf else c
    if lines[p][l-1][c:c+len(old)]!=old: warn.append(f'MISS {p}:{l}:{c} {old} got {lines[p][l-1][c:c+len(old)]!r}'); return
    edits[p].add((l,c,len(old),new))
sym={}; attr={}; modules={}
for path,kind,old,new in rows:
    m=modname(pathlib.Path(path))
    if m not in mod and kind!='module': warn.append(f'NO FILE {path}'); continue
    if kind in('class','function','constant'):
        if old not in tops[mod[m]]: warn.append(f'NOT DEFINED {path} {old}'); continue
        sym[(m,old)]=new
    elif kind in('method','attribute'):
        c,_,a=old.rpartition('.'); n=new.rpartition('.')[2]
        attr.setdefault(a,[]).append((path,c,n))
    elif kind=='module': modules[path]=new
# symbols
bybind=collections.defaultdict(dict)  # file -> local old -> new
for p in files:
    m=modname(p)
    for n in tops[p]:
        if (m,n) in sym: bybind[p][n]=sym[(m,n)]
    for local,(mm,nn) in binds[p].items():
        if nn is None: continue
        o=origin(mm,nn)
        if o in sym and local==nn and o[1]==nn: bybind[p][local]=sym[o]
def dotted(n):
    if isinstance(n,ast.Name): return n.id
    if isinstance(n,ast.Attribute):
        d=dotted(n.value); return d and d+'.'+n.attr
def target_module(p,expr):
    d=dotted(expr)
    if not d: return None
    head,*rest=d.split('.')
    b=binds[p].get(head)
    if b is None: return None
    o=origin(*b) if b[1] else (('module',b[0]) if b[0] in mod else None)
    if not o or o[0]!='module': return None
    m=o[1]
    for r in rest:
        o=origin(m,r)
        if not o or o[0]!='module': return None
        m=o[1]
    return m
def defpos(p,n):
    l=n.lineno
    s=lines[p][l-1]; i=s.index(n.name, n.col_offset+ (6 if isinstance(n,ast.ClassDef) else 4))
    return l,i
for p,t in tree.items():
    loc=bybind[p]
    for n in ast.walk(t):
        if isinstance(n,ast.Name) and n.id in loc: add(p,n.lineno,n.col_offset,n.id,loc[n.id])
        elif isinstance(n,(ast.ClassDef,ast.FunctionDef,ast.AsyncFunctionDef)) and n.name in loc and (modname(p),n.name) in sym:
            if n in t.body or isinstance(n,ast.ClassDef):
                l,c=defpos(p,n); add(p,l,c,n.name,loc[n.name],False)
        elif isinstance(n,(ast.FunctionDef,ast.AsyncFunctionDef,ast.Lambda)):
            pass
        elif isinstance(n,ast.ImportFrom):
            m=resolve_rel(p,n)
            for a in n.names:
                o=origin(m,a.name)
                if o in sym and o[1]==a.name: add(p,a.lineno,a.col_offset,a.name,sym[o])
        elif isinstance(n,ast.Attribute):
            m=target_module(p,n.value)
            if m:
                o=origin(m,n.attr)
                if o in sym and o[1]==n.attr: add(p,n.end_lineno,n.end_col_offset-len(n.attr.encode()),n.attr,sym[o])
        elif isinstance(n,ast.Constant) and isinstance(n.value,str) and n.value in loc and n.value[0].isupper() and n.lineno==n.end_lineno:
            add(p,n.lineno,n.col_offset+1,n.value,loc[n.value])  # quoted annotation, or in __all__
        elif isinstance(n,ast.Assign) and any(isinstance(x,ast.Name) and x.id=='__all__' for x in n.targets):
            for x in ast.walk(n.value):
                if isinstance(x,ast.Constant) and x.value in loc and not x.value[0].isupper(): add(p,x.lineno,x.col_offset+1,x.value,loc[x.value])
        elif isinstance(n,ast.arg) and n.arg in loc: warn.append(f'SHADOW {p}:{n.lineno} parameter {n.arg}')
        if isinstance(n,ast.Name) and isinstance(n.ctx,ast.Store) and n.id in loc and not any(isinstance(x,(ast.Assign,ast.AnnAssign)) and n in ast.walk(x) for x in t.body): warn.append(f'SHADOW {p}:{n.lineno} {n.id}')
# attributes, by name everywhere they are defined
defs=collections.defaultdict(set)
for p,t in tree.items():
    for c in ast.walk(t):
        if isinstance(c,ast.ClassDef):
            for n in ast.walk(c):
                if isinstance(n,(ast.FunctionDef,ast.AsyncFunctionDef)): defs[n.name].add((p,c.name))
                elif isinstance(n,ast.Attribute) and isinstance(n.value,ast.Name) and n.value.id=='self' and isinstance(n.ctx,ast.Store): defs[n.attr].add((p,c.name))
            for n in c.body:
                if isinstance(n,ast.AnnAssign) and isinstance(n.target,ast.Name): defs[n.target.id].add((p,c.name))
                if isinstance(n,ast.Assign):
                    for x in n.targets:
                        if isinstance(x,ast.Name): defs[x.id].add((p,c.name))
for a,list_ in attr.items():
    news={n for *_,n in list_}
    if len(news)>1: warn.append(f'CONFLICT {a} -> {news}'); continue
    new=news.pop()
    want={(pathlib.Path(p),c) for p,c,_ in list_}
    extra={d for d in defs[a]-want if d[0].parts[0] in('edge','exporters')}
    if not want&defs[a]: warn.append(f'NOT FOUND attr {a} in {want}'); continue
    if extra: warn.append(f'SKIP attr {a} -> {new}: also in '+', '.join(f'{p}:{c}' for p,c in sorted(extra))); continue
    classes={c for _,c in want}
    for p,t in tree.items():
        for n in ast.walk(t):
            if isinstance(n,ast.Attribute) and n.attr==a and not target_module(p,n.value): add(p,n.end_lineno,n.end_col_offset-len(a.encode()),a,new)
            elif isinstance(n,(ast.FunctionDef,ast.AsyncFunctionDef)) and n.name==a and n.col_offset>0:
                l,c=defpos(p,n); add(p,l,c,a,new,False)
            elif isinstance(n,ast.ClassDef):
                for b in n.body:
                    if isinstance(b,ast.AnnAssign) and isinstance(b.target,ast.Name) and b.target.id==a: add(p,b.target.lineno,b.target.col_offset,a,new)
                    if isinstance(b,ast.Assign):
                        for x in b.targets:
                            if isinstance(x,ast.Name) and x.id==a: add(p,x.lineno,x.col_offset,a,new)
            elif isinstance(n,ast.Call):
                d=dotted(n.func); last=d.split('.')[-1] if d else ''
                for k in n.keywords:
                    if k.arg==a:
                        if last in classes or last=='replace': add(p,k.lineno,k.col_offset,a,new)
                        else: warn.append(f'KEYWORD {p}:{k.lineno} {d}({a}=)')
            elif isinstance(n,ast.MatchClass):
                if a in n.kwd_attrs: warn.append(f'MATCH {p}:{n.lineno} {a}')
            elif isinstance(n,ast.Constant) and n.value==a: warn.append(f'STRING {p}:{n.lineno} {a!r} -> {new}')
# texts: docstrings, comments, strings
full={f'{m}.{o}':f'{m}.{n}' for (m,o),n in sym.items()}; full.update({f'{m}:{o}':f'{m}:{n}' for (m,o),n in sym.items()})
for p,t in list(tree.items()):  # apply position edits
    es=sorted(edits[p],reverse=True)
    L=lines[p]
    for l,c,k,new in es: L[l-1]=L[l-1][:c]+new+L[l-1][c+k:]
    s='\n'.join(L)
    for o,n in full.items():
        if o in s: s=re.sub(re.escape(o)+r'\b',n,s)
    for o,n in bybind[p].items():
        s=re.sub(r'(`(?:[\w.]+\.)?)'+o+r'(?=(?:\.\w+)*(?:\([^`]*\))?`)',r'\g<1>'+n,s)
    for a,list_ in attr.items():
        pass
    if s!=src[p]:
        if not dry: p.write_text(s)
uniq=collections.Counter()
for p in files:
    if p.parts[0]=='edge':
        for n in ast.walk(tree[p]):
            if isinstance(n,ast.ClassDef): uniq[n.name]+=1
for p in [pathlib.Path(f) for f in subprocess.check_output(['git','ls-files','*.md','*.py'],text=True).split()]:
    s=p.read_text(); o_=s
    if p.name=='CHANGELOG.md': continue
    for o,n in full.items(): s=re.sub(re.escape(o)+r'\b',n,s)
    for (m,o),n in sym.items():
        if uniq[o]==1 and o[0].isupper(): s=re.sub(r'(`(?:[\w.]+\.)?)'+o+r'(?=(?:\.\w+)*(?:\([^`]*\))?`)',r'\g<1>'+n,s)
        elif p.suffix=='.md' and re.search('`'+o+r'\b',s): warn.append(f'DOC {p}: `{o}`')
    if p.suffix=='.md':
        for m_ in re.finditer(r'^from ([\w.]+) import (.*)$',o_,re.M):
            for nm in re.findall(r'\w+',m_[2]):
                og=origin(m_[1],nm)
                if og in sym: s=re.sub(r'(?<![\w.`"/-])'+nm+r'\b(?=[\s,(.:)\]]|$)',sym[og],s)
    if s!=o_ and not dry: p.write_text(s)
for w in sorted(set(warn)): print(w)
print(sum(map(len,edits.values())),'edits in',len([p for p in edits if edits[p]]),'files')
if modules: print('modules to move by hand:',modules)
