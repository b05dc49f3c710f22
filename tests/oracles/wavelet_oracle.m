% GNU Octave's answers for cyclofeat.signal.wavelets. Run in this folder:
%   octave-cli wavelet_oracle.m [folder for the two output files, default: here]
% Octave has no wavelet toolbox, and no package is needed: the recipe of MATLAB's example "Continuous and
% Discrete Wavelet Analysis" ("Discrete Wavelet Transform, Absolute Coefficients") is written out here from the
% documentation of its functions. The committed outputs are those of Octave 7.3.0.
% wavelet_filters.csv: decomposition filters, one column each: mb32.3 low and high, db2 low and high (the
%   latter two padded with NaN).
% wavelet_input.csv: three made-up torques in Nm, one column each: ripple with a burst; one that stands still
%   for its first half; a constant.
1;  % a script, though it begins with functions

function x = extended(x, n_more)
  % dwtmode 'sym': half-sample symmetric extension by n_more on both sides, mirrored over and over if need be.
  n = numel(x);
  k = mod((1 - n_more):(n + n_more), 2 * n);
  k(k == 0) = 2 * n;
  k(k > n) = 2 * n + 1 - k(k > n);
  x = x(k);
end

function [a, d] = dwt_step(x, lo, hi)
  % dwt: convolve what was extended by the filter's length less one, keep the even samples.
  y = extended(x, numel(lo) - 1);
  a = conv(y, lo, 'valid')(2:2:end);
  d = conv(y, hi, 'valid')(2:2:end);
end

function y = kept(x, n)
  % wkeep(x, n): the central part; of an odd surplus the greater part leaves at the end.
  first = floor((numel(x) - n) / 2);
  y = x(first + (1:n));
end

function c = coded(x, n_colours)
  % wcodemat(x, n_colours, 'row'): absolute values on a regular grid from the row's minimum to its maximum.
  x = abs(x);
  low = min(x);
  span = max(x) - low;
  if span < eps
    c = ones(size(x));
  else
    c = min(1 + fix(n_colours * ((x - low) / span)), n_colours);
  end
end

arguments = argv();
folder = '.';
if numel(arguments) > 0
  folder = arguments{end};
end
filters = csvread('wavelet_filters.csv');
torques = csvread('wavelet_input.csv');
levels = 9;
n_colours = 64;
details_file = fopen(fullfile(folder, 'wavelet_details.csv'), 'w');
fprintf(details_file, 'wavelet,torque,level,index,detail\n');
colours_file = fopen(fullfile(folder, 'wavelet_colours.csv'), 'w');
fprintf(colours_file, 'wavelet,torque,level,colours\n');
names = {'mb32.3', 'db2'};
for w = 1:2
  lo = filters(~isnan(filters(:, 2 * w - 1)), 2 * w - 1)';
  hi = filters(~isnan(filters(:, 2 * w)), 2 * w)';
  for t = 1:columns(torques)
    a = torques(:, t)';
    n = numel(a);
    for k = 1:levels
      [a, d] = dwt_step(a, lo, hi);
      for i = 1:numel(d)
        fprintf(details_file, '%s,%d,%d,%d,%.17g\n', names{w}, t - 1, k, i - 1, d(i));
      end
      row = d(ones(1, 2^k), :);
      row = kept(row(:)', n);
      row(abs(row) < sqrt(eps)) = 0;
      fprintf(colours_file, '%s,%d,%d,%s\n', names{w}, t - 1, k, num2str(coded(row, n_colours), '%d '));
    end
  end
end
fclose(details_file);
fclose(colours_file);
