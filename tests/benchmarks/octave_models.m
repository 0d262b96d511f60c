% Octave's n4sid and arx on many records, for subspace.py and daisy.py; needs its package control.
% IN.mat holds U and Y (N x records), orders, and methods ("n4sid", "arx"). A line of the output is
% record (from 0), method, order, A; B; C as polynomials in q^-1, C being det(q - A + K C).
pkg load control
args = argv();
load(args{1});
warning("off", "all");
out = fopen(args{2}, "w");
if ischar(methods)
  methods = {methods};
endif
text = @(p) sprintf(" %.17g", p);
for r = 1:columns(U)
  data = iddata(Y(:, r), U(:, r), 1);
  for m = 1:numel(methods)
    for n = orders(:)'
      try
        if strcmp(methods{m}, "n4sid")
          [sys, x0, info] = n4sid(data, n);
          [a, b, c, d] = ssdata(sys);
          A = poly(a);
          B = poly(a - b * c) + (d - 1) * A;
          C = poly(a - info.K * c);
        else
          sys = arx(data, "na", n, "nb", n);
          [B, A] = tfdata(sys(1, 1), "vector");
          B = [zeros(1, numel(A) - numel(B)), B];
          C = 1;
        endif
        fprintf(out, "%d %s %d;%s;%s;%s\n", r - 1, methods{m}, n, text(A), text(B), text(C));
      catch failure
        fprintf(out, "%d %s %d;failed: %s\n", r - 1, methods{m}, n, failure.message);
      end_try_catch
    endfor
  endfor
endfor
fclose(out);
